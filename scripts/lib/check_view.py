"""Looks at the page of `egotac view` in a headless Chromium: check_view.py URL FRAME [SCREENSHOT].

Source 0 is a labelled store with truth whose image FRAME has touch, source 1 a video that the network does not know. FRAME is an
index. SCREENSHOT is a PNG file to write.
"""

import subprocess
import sys

import numpy as np

from browser import Browser

UNKNOWN = np.array([150, 158, 168])


def pixels(png):
    """Decodes a PNG file to (H, W, 3) by ffmpeg."""
    command = ["ffmpeg", "-v", "error", "-i", "-", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(command, input=png, stdout=subprocess.PIPE, check=True).stdout
    width, height = (int.from_bytes(png[at : at + 4], "big") for at in (16, 20))
    return np.frombuffer(raw, np.uint8).reshape(height, width, 3).astype(int)


def part(browser, picture, selector):
    """Returns the part of a screenshot that an element covers."""
    box = browser.evaluate(
        f"(box => [box.left, box.top, box.right, box.bottom])(document.querySelector('{selector}').getBoundingClientRect())"
    )
    left, top, right, bottom = (max(0, round(value)) for value in box)
    return picture[top:bottom, left:right]


def near(picture, color, distance):
    """Counts the pixels near a colour."""
    return int((np.abs(picture - np.array(color)).max(axis=2) <= distance).sum())


def panels(picture, rows):
    """Splits the picture of the hands into its panels, without the lines of text above them."""
    height, width = picture.shape[0] // rows, picture.shape[1] // 2
    return [picture[row * height + 24 : (row + 1) * height, side * width : (side + 1) * width] for row in range(rows) for side in (0, 1)]


def choose(browser, identity, value, event):
    browser.evaluate(f"(it => {{ it.value = {value}; it.dispatchEvent(new Event('{event}')); }})(document.getElementById('{identity}'))")


def check(fact, holds, seen=""):
    print(f"{'ok' if holds else 'FAILED'}: {fact} {seen}", flush=True)
    if not holds:
        raise SystemExit(1)


def store(browser, frame):
    choose(browser, "frame", frame, "input")
    browser.wait(f"document.body.dataset.frame === '{frame}'")
    picture = pixels(browser.screenshot())
    hands = part(browser, picture, "#hands")
    drawn = [int((panel.min(axis=2) < 240).sum()) for panel in panels(hands, 2)]
    check("both hands are drawn, and those of the truth", min(drawn) > 5000, drawn)
    # Orange to violet: far from grey, and darker than the sand of no force.
    warm = [int(((panel[..., 0] - panel[..., 2] > 70) & (panel[..., 0] > 100)).sum()) for panel in panels(hands, 2)]
    check("a hand and its truth show force", max(warm[:2]) > 60 and max(warm[2:]) > 60, warm)
    # The scene holds a left hand alone: the network knows nothing of a right one, the simulator knows that it is not there.
    grey = [near(panel, UNKNOWN, 6) for panel in panels(hands, 2)]
    check("only the predicted right hand is unknown", grey[1] > 2000 and max(grey[0], grey[2], grey[3]) < 200, grey)
    chart = part(browser, picture, "#chart")
    check("the curve of a hand is drawn", near(chart, [0x1B, 0x5F, 0xAE], 40) + near(chart, [0xC2, 0x41, 0x0C], 40) > 300)
    check("familiarity is drawn", near(chart, [0x9E, 0xCA, 0xE8], 12) > 300)
    image = part(browser, picture, "#image")
    check("the image is drawn", image.std() > 15, round(float(image.std()), 1))
    browser.evaluate("document.getElementById('shows-overlay').click()")
    bare = part(browser, pixels(browser.screenshot()), "#image")
    changed = int((np.abs(bare - image).max(axis=2) > 12).sum())
    check("hands lie on the image where the camera sees them", 2000 < changed < bare.shape[0] * bare.shape[1] // 2, changed)
    browser.evaluate("document.getElementById('shows-overlay').click()")
    total, truth = browser.evaluate("[document.body.dataset.total, document.body.dataset.truth]")
    check("totals are known but that of the right hand", "null" not in truth and total.endswith(",null]") and not total.startswith("[null"), f"{total} {truth}")


def playing(browser):
    choose(browser, "frame", 0, "input")
    browser.wait("document.body.dataset.frame === '0'")
    choose(browser, "speed", 4, "change")
    browser.evaluate("document.getElementById('play').click()")
    browser.wait("Number(document.body.dataset.frame) > 30", 60)
    print("plays at", browser.evaluate("document.getElementById('rate').textContent"), flush=True)
    browser.evaluate("document.getElementById('play').click()")
    # A click into the middle of the curve shows the image in the middle.
    last = int(browser.evaluate("document.getElementById('frame').max"))
    browser.evaluate(
        "(box => document.getElementById('chart').dispatchEvent(new PointerEvent('pointerdown', "
        "{clientX: box.left + box.width * 0.528, clientY: box.top + 20})))(document.getElementById('chart').getBoundingClientRect())"
    )
    browser.wait(f"Math.abs(Number(document.body.dataset.frame) - {last / 2}) < {0.1 * last}")
    check("a click on the curve shows the image of that time", True)


def video(browser):
    choose(browser, "source", 1, "change")
    browser.wait("document.body.dataset.source === '1' && document.body.dataset.total === '[null,null]'")
    picture = pixels(browser.screenshot())
    hands = panels(part(browser, picture, "#hands"), 1)
    # The grey of the unknown, shaded: all channels within a few steps of each other, blue the largest.
    grey = [int(((panel[..., 2] >= panel[..., 0]) & (panel.max(axis=2) < 235) & (np.ptp(panel, axis=2) < 40)).sum()) for panel in hands]
    warm = [int((panel[..., 0] - panel[..., 2] > 25).sum()) for panel in hands]
    check("hands of unknown touch are grey", min(grey) > 5000 and max(warm) < 50, f"{grey} {warm}")
    text = browser.evaluate("document.body.innerText")
    check("unknown touch is called unknown, and nothing is 0.00 N", "left: unknown" in text and "0.00 N\t" not in text)
    check("the reason is told", "unlike those of the training" in text)
    colors = len(np.unique(part(browser, picture, "#image").reshape(-1, 3) // 64, axis=0))
    check("the video's image is drawn", colors > 8, colors)


def main():
    url, frame = sys.argv[1], int(sys.argv[2])
    browser = Browser(1400, 1240)
    try:
        browser.open(url)
        browser.wait("Number(document.body.dataset.updates) > 0")
        store(browser, frame)
        if len(sys.argv) > 3:
            with open(sys.argv[3], "wb") as file:
                file.write(browser.screenshot())
        playing(browser)
        video(browser)
        host = url.split("/")[2]
        outside = [asked for asked in browser.urls if asked.split("/")[2:3] != [host] and not asked.startswith(("data:", "blob:"))]
        check("the page asks for nothing from outside", not outside, outside)
        check("the page has no errors", not browser.errors, browser.errors)
    finally:
        browser.close()


main()
