"""Takes pictures of the page of `egotac view` in a headless Chromium: film_view.py URL FOLDER.

Source 0 is a labelled store: FOLDER gets frame_000.png, frame_001.png ... of every third image, from one in which the hand grips. Source 1 is a labelled store with
another look: FOLDER gets still.png of the image in its middle.
"""

import sys
from pathlib import Path

from browser import Browser

STEP = 3
SIZE = (1240, 1060)


def show(browser, frame):
    """Moves the slider to an image and waits until it is shown."""
    browser.evaluate(
        f"(it => {{ it.value = {frame}; it.dispatchEvent(new Event('input')); }})(document.getElementById('frame'))"
    )
    browser.wait(f"document.body.dataset.frame === '{frame}'")


def choose(browser, source):
    """Shows another source."""
    browser.evaluate(
        f"(it => {{ it.value = {source}; it.dispatchEvent(new Event('change')); }})(document.getElementById('source'))"
    )
    browser.wait(f"document.body.dataset.source === '{source}'")


def last_image(browser):
    """Returns the index of the last image of the source."""
    browser.wait("Number(document.getElementById('frame').max) > 1")
    return int(browser.evaluate("document.getElementById('frame').max"))


def main():
    url, folder = sys.argv[1], Path(sys.argv[2])
    browser = Browser(*SIZE)
    try:
        browser.open(url)
        browser.wait("Number(document.body.dataset.updates) > 0")
        # Pages that don't move show the first frame: it has touch. The rate is that of the filming.
        browser.evaluate("document.getElementById('rate').hidden = true")
        frames = list(range(0, last_image(browser) + 1, STEP))
        begin = 2 * len(frames) // 5
        for number, frame in enumerate(frames[begin:] + frames[:begin]):
            show(browser, frame)
            (folder / f"frame_{number:03}.png").write_bytes(browser.screenshot())
        choose(browser, 1)
        show(browser, last_image(browser) // 2)
        # The image alone: its look is what is to be seen.
        browser.evaluate("document.getElementById('shows-overlay').click()")
        (folder / "still.png").write_bytes(browser.screenshot())
        if browser.errors:
            raise SystemExit(f"the page has errors: {browser.errors}")
    finally:
        browser.close()


main()
