"""Open reports in headless Chromium, as a phone, a screen and paper show them; say what is wrong with each.

    pip install playwright && npm pack axe-core   # and Debian's chromium
    python .ci/check_reports.py --axe package/axe.min.js --out looked runs/a/report.html runs/b/report.html

Looked for: console messages, requests, pages wider than the screen, figures that the keyboard cannot enlarge, and what
axe finds of contrast, names and structure. Screenshots and PDFs in --out are for one's own eyes.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from playwright.sync_api import Browser, Page, sync_playwright

WIDTHS = (390, 1280)
PAPER = 718  # pixels between the margins of A4
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"]
FLAGS += ["--disable-background-networking", "--disable-component-update"]
AXE = "async () => (await axe.run()).violations.flatMap(v => v.nodes.map(n => `${v.id}: ${n.html.slice(0, 100)}`))"


def faults(browser: Browser, report: Path, width: int, axe: str | None, out: Path) -> Iterator[str]:
    page = browser.new_page(viewport={"width": width, "height": 844})
    heard: list[str] = []
    page.on("console", lambda message: heard.append(f"console: {message.text}"))
    page.on("pageerror", lambda error: heard.append(f"error: {error}"))
    page.on("request", lambda request: heard.append(f"request: {request.url[:100]}"))
    page.goto(report.resolve().as_uri())
    name = f"{report.parent.name}-{width}"
    page.screenshot(path=out / f"{name}.png", full_page=True)
    yield from (each for each in heard if not each.startswith(("request: file:", "request: data:")))
    if (wide := page.evaluate("document.documentElement.scrollWidth")) > width:
        yield f"{wide} pixels wide"
    yield from _enlarged(page, out / f"{name}-enlarged.png")
    page.evaluate("document.querySelectorAll('details').forEach(each => each.open = true)")
    if axe:
        page.evaluate(axe)
        yield from page.evaluate(AXE)
    page.emulate_media(media="print")
    page.set_viewport_size({"width": PAPER, "height": 1000})
    if (wide := page.evaluate("document.documentElement.scrollWidth")) > PAPER:
        yield f"{wide} pixels wide on paper, which has {PAPER}"
    page.pdf(path=out / f"{report.parent.name}.pdf", format="A4")
    page.close()


def _enlarged(page: Page, screenshot: Path) -> Iterator[str]:
    """Enter opens each figure, Esc closes it, and the focus is where it was."""
    for number in range(page.locator(".enlarge").count()):
        page.locator(".enlarge").nth(number).focus()
        page.keyboard.press("Enter")
        if not page.evaluate("document.querySelector('dialog').open"):
            yield f"figure {number + 1}: Enter does not enlarge it"
        if number == 0:
            page.screenshot(path=screenshot)
        page.keyboard.press("Escape")
        if page.evaluate("document.querySelector('dialog').open"):
            yield f"figure {number + 1}: Esc does not close it"
        back = f"document.activeElement === document.querySelectorAll('.enlarge')[{number}]"
        if not page.evaluate(back):
            yield f"figure {number + 1}: the focus is lost"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reports", nargs="+", type=Path)
    parser.add_argument("--axe", type=Path, help="axe.min.js of axe-core")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--chromium", default="/usr/bin/chromium")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    axe = options.axe.read_text(encoding="utf-8") if options.axe else None
    found = 0
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=options.chromium, args=FLAGS)
        for report in options.reports:
            for width in WIDTHS:
                for fault in faults(browser, report, width, axe, options.out):
                    print(f"{report} at {width}: {fault}")
                    found += 1
        browser.close()
    print(f"{len(options.reports)} reports, {found} faults")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
