"""MkDocs hook: the site's pages are the repository's, at the same paths, and the files that they link to."""

from __future__ import annotations

import re
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from posixpath import dirname, join, normpath

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files, InclusionLevel
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(Path(__file__).parent))  # MkDocs loads a hook from its file, outside any package

import keys  # noqa: E402
import sequence  # noqa: E402

PAGES = ("*.md", "docs/**/*.md", "experiments/*.md", "assets/mjcf/*.md")
PICTURES = (".png", ".webp", ".svg")
BESIDE_PAGES = (*(f"docs/*/*{kind}" for kind in PICTURES), "docs/*.ipynb", "docs/site/*.js", "docs/site/*.css")
KEYS = "docs/reference/keys.md"
WIDE = (KEYS, "docs/results-paper.md")  # pages whose tables take the place of their contents
BESIDE = InclusionLevel.NOT_IN_NAV
LINK = re.compile(r"(?<=\]\()(?!https?:|#)([^)#\s]+)")
EMPTY_HEAD = re.compile(r"<th[^>]*></th>")
NAV_LABEL = re.compile(r'(?<=<nav class="md-nav" aria-label=")[^"]+')
DIAGRAM = re.compile(r"^```mermaid\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """In place of docs/ alone: pages, pictures, the files that pages link to, and what is made of the schemas."""
    for file in [file for file in files if file.src_dir == config.docs_dir]:
        files.remove(file)
    pages = list(_found(PAGES))
    for path in [*pages, *_found(BESIDE_PAGES)]:
        files.append(File.generated(config, _uri(path), abs_src_path=str(path)))
    for source in sorted({source for page in pages for source in _sources(page)}):
        listing = _listing(source)
        files.append(File.generated(config, f"{_uri(source)}.md", content=listing, inclusion=BESIDE))
    files.append(File.generated(config, KEYS, content=keys.page()))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links to files of the repository lead to their listings; diagrams are drawn; wide tables have room."""

    def listed(link: re.Match[str]) -> str:
        target = normpath(join(dirname(page.file.src_uri), link[1]))
        return f"{link[1]}.md" if files.get_file_from_path(f"{target}.md") else link[1]

    if page.file.src_uri in WIDE:
        page.meta["hide"] = ["toc"]
    label = f"{page.title}: a sequence diagram"
    return DIAGRAM.sub(lambda found: sequence.figure(found[1], label), LINK.sub(listed, markdown))


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """No page for what a web server does not find: opened from a folder it would have no style."""
    config.theme.static_templates.discard("404.html")
    return config


def on_post_page(output: str, *, page: Page, config: MkDocsConfig) -> str:
    """Names for screen readers that the theme leaves out or gives twice; a table's empty corner heads nothing."""
    seen: Counter[str] = Counter()

    def numbered(label: re.Match[str]) -> str:
        key = label[0].lower()
        seen[key] += 1
        return label[0] if seen[key] == 1 else f"{label[0]} {seen[key]}"

    named = NAV_LABEL.sub(numbered, output.replace('role="dialog"', 'role="dialog" aria-label="Search"'))
    return EMPTY_HEAD.sub("<td></td>", named)


def _found(patterns: tuple[str, ...]) -> Iterator[Path]:
    return (path for pattern in patterns for path in sorted(ROOT.glob(pattern)))


def _uri(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def _sources(page: Path) -> Iterator[Path]:
    """Files and folders of the repository, no pages and no pictures, to which a page links."""
    for link in LINK.findall(page.read_text(encoding="utf-8")):
        target = (page.parent / link).resolve()
        if target.suffix not in (".md", ".ipynb", *PICTURES) and target.exists():
            yield target


def _listing(source: Path) -> str:
    """A file as a block of code, of a compressed one its name; a folder as its files, one below the other."""
    files = sorted(path for path in source.iterdir() if path.is_file()) if source.is_dir() else [source]
    blocks = [
        f"`{_uri(file)}`\n"
        + ("" if file.suffix == ".gz" else f"\n````{_language(file)}\n{file.read_text('utf-8')}````\n")
        for file in files
    ]
    return "\n".join([f"# {source.name}\n", *blocks])


def _language(file: Path) -> str:
    return {".py": "python", ".yaml": "yaml", ".cff": "yaml", ".xml": "xml"}.get(file.suffix, "text")
