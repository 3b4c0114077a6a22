"""Measures how fast the page of `egotac view` shows its first source in a headless Chromium: rate_view.py URL SECONDS.

Plays the recording at its own speed, or looks at the live source, for this time or until it ends; prints images shown per second and
images left out as a JSON object.
"""

import json
import sys
import time

from browser import Browser


def main():
    url, secs = sys.argv[1], float(sys.argv[2])
    browser = Browser(1400, 1060)
    try:
        browser.open(url)
        browser.wait("Number(document.body.dataset.updates) > 0")
        state = lambda: browser.evaluate("['updates', 'dropped', 'playing'].map(name => JSON.parse(document.body.dataset[name]))")
        browser.evaluate("document.getElementById('play').click()")
        # The first images also pay for what is made once.
        browser.wait("Number(document.body.dataset.updates) > 20", 60)
        begun, (shown, dropped, is_recording) = time.monotonic(), state()
        while time.monotonic() < begun + secs:
            time.sleep(secs)
            now, (updates, left_out, is_playing) = time.monotonic(), state()
            if is_recording and not is_playing:
                break
        span = now - begun
        print(json.dumps({"images_per_second": round((updates - shown) / span, 1), "left_out": left_out - dropped, "seconds": round(span, 1)}))
    finally:
        browser.close()


main()
