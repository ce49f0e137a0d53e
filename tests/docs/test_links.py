"""The link checker finds what leads nowhere, and nothing else."""

from __future__ import annotations

from pathlib import Path

from docs.links import dead_links

PAGE = """<html><head><link rel="stylesheet" href="a.css"><link rel="canonical" href="https://x.org/"></head>
<body><h1 id="top">a</h1><a name="old"></a><a href="#top">.</a><a href="sub/b.html#b%C3%A9">.</a>
<a href="https://x.org/nowhere">.</a><a href="mailto:x@x.org">.</a>
<img src="data:image/png;base64,AA=="></body>"""


def site(folder: Path, more: str = "") -> Path:
    (folder / "sub").mkdir()
    (folder / "a.css").write_text("a { background: url(b.png) }")
    (folder / "index.html").write_text(PAGE + more)
    (folder / "sub" / "b.html").write_text('<p id="bé"><a href="..">up</a> <a href="../#old">up</a>')
    return folder


def test_a_sound_site_has_no_dead_links(tmp_path: Path) -> None:
    assert dead_links(site(tmp_path)) == []


def test_every_kind_of_dead_link_is_named(tmp_path: Path) -> None:
    more = """<a href="c.html">.</a><a href="#nowhere">.</a><a href="sub/b.html#nowhere">.</a>
    <img src="no.png"><script src="https://x.org/x.js"></script><link rel="preconnect" href="//x.org">"""
    made = site(tmp_path, more)
    (made / "a.css").write_text("@import 'https://x.org/x.css'; a { background: url(//x.org/y.png) }")
    assert dead_links(made) == [
        "index.html: no file for c.html",
        "index.html: no anchor for #nowhere",
        "index.html: no anchor for sub/b.html#nowhere",
        "index.html: no file for no.png",
        "index.html: fetches https://x.org/x.js",
        "index.html: fetches //x.org",
        "a.css: fetches https://x.org/x.css",
        "a.css: fetches //x.org/y.png",
    ]
