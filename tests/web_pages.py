"""What the text of a page that the project writes can tell: all has a name, and nothing comes from outside."""

from __future__ import annotations

import re
from html.parser import HTMLParser


class Tags(HTMLParser):
    """Start tags and their attributes, in order; texts by the innermost tag that is open."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []
        self._open: list[str] = []
        self.feed(html)
        assert [tag for tag in self._open if tag not in ("meta", "img", "source")] == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        while self._open.pop() != tag:
            assert self._open, f"{tag} was never opened"

    def handle_data(self, data: str) -> None:
        if data.strip():
            self.texts.append((self._open[-1], data.strip()))

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


def assert_sound(html: str) -> None:
    """One self-contained page: language, title, viewport, alternative texts, headers; it asks for nothing."""
    page = Tags(html)
    assert page.all("html")[0]["lang"] == "en"
    assert [text for tag, text in page.texts if tag == "title"]
    assert {"name": "viewport", "content": "width=device-width, initial-scale=1"} in page.all("meta")
    assert len(page.all("h1")) == len(page.all("main")) == 1
    for image in page.all("img"):
        assert image["alt"]
        assert str(image["src"]).startswith("data:image/png;base64,")
    for tag in ("th", "summary", "figcaption"):
        assert len([text for name, text in page.texts if name == tag]) >= len(page.all(tag)), f"an empty {tag}"
    regions = [each for each in page.all("div") if each.get("role") == "region"]
    assert len(regions) == len(page.all("table"))
    assert all(region["aria-label"] and region["tabindex"] == "0" for region in regions)
    assert not [tag for tag, _ in page.tags if tag in ("link", "iframe", "object", "embed")]
    addresses = {name for _, attributes in page.tags for name in ("href", "srcset", "action") if name in attributes}
    assert not addresses
    look = "".join(re.findall(r"<(?:style|script)>(.*?)</(?:style|script)>", html, re.DOTALL))
    assert not re.findall(r"https?:|@import|url\(|fetch\(", look)
