"""What leads nowhere in a built site: a checker that knows of HTML only what it needs."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADED = {("script", "src"), ("img", "src"), ("iframe", "src"), ("source", "src"), ("source", "srcset")}
"""What a browser fetches without being asked to, beside what <link> names."""
FETCHED_RELATIONS = {"stylesheet", "icon", "preload", "prefetch", "preconnect", "dns-prefetch", "manifest"}


class Page(HTMLParser):
    """The links and the anchors of one page.

    Attributes:
        anchors: every place in it that a link may name.
        links: what it refers to: the attribute's text, and whether browsers fetch it by themselves.
    """

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[tuple[str, bool]] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.anchors.update(given[name] for name in ("id", "name") if given.get(name))
        relations = set(given.get("rel", "").split())
        for name in ("href", "src", "srcset"):
            if name in given:
                fetched = (tag, name) in LOADED or (tag == "link" and bool(relations & FETCHED_RELATIONS))
                self.links.append((given[name], fetched))


def dead_links(site: Path) -> list[str]:
    """One line for each link between pages of a site that leads nowhere, or fetches from elsewhere.

    Args:
        site: folder of the built site.
    """
    pages = {path.resolve(): Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    faults = []
    for path, page in pages.items():
        name = path.relative_to(site.resolve())
        for link, fetched in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                if fetched and parts.scheme != "data":
                    faults.append(f"{name}: fetches {link}")
                continue
            where = path
            if parts.path:
                root = site if parts.path.startswith("/") else path.parent
                where = (root / unquote(parts.path).lstrip("/")).resolve()
                if where.is_dir():
                    where = where / "index.html"
            if not where.is_file():
                faults.append(f"{name}: no file for {link}")
            elif parts.fragment and where in pages and unquote(parts.fragment) not in pages[where].anchors:
                faults.append(f"{name}: no anchor for {link}")
    for path in sorted(site.rglob("*.css")):
        fetched_by_style = re.findall(r"(?:url\(|@import)\s*['\"]?((?:https?:)?//[^)'\"]+)", path.read_text())
        faults += [f"{path.relative_to(site)}: fetches {link}" for link in fetched_by_style]
    return faults
