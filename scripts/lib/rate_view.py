"""Measures how fast the page of `egotac view` shows its first source in a headless Chromium: rate_view.py URL SECONDS.

Plays the recording at its own speed for this time; prints images shown per second and images left out as a JSON object.
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
        begun, (shown, dropped, _) = time.monotonic(), state()
        time.sleep(secs)
        span, (updates, left_out, is_playing) = time.monotonic() - begun, state()
        if not is_playing:
            raise SystemExit(f"expected a recording longer than {secs:.0f} s, got one that ended")
        print(json.dumps({"images_per_second": round((updates - shown) / span, 1), "left_out": left_out - dropped, "seconds": round(span, 1)}))
    finally:
        browser.close()


main()
