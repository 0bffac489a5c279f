"""Parts of an HTML page that needs nothing beside it: pictures and videos are inside."""

import base64
import html
from collections.abc import Container, Iterable, Sequence

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 66rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
table { border-collapse: collapse; margin: .8rem 0; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .8rem; border-bottom: 1px solid #ddd; text-align: left; vertical-align: top; }
.number { text-align: right; white-space: nowrap; } .small { color: #555; font-size: 13px; }
.good, .bad { padding: .5rem .9rem; border-radius: .3rem; } .good { background: #e3f1dd; } .bad { background: #f8dedb; }
figure { margin: 0 0 1.2rem; } img, video { max-width: 100%; } code { word-break: break-all; }
"""


def whole_page(title: str, body: str, style: str = "") -> str:
    """The page of ``body``, which is HTML already; ``title`` is plain text, ``style`` follows STYLE."""
    head = f'<meta charset="utf-8"><title>{html.escape(title)}</title><style>{STYLE}{style}</style>'
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{body}</body></html>\n'


def heading(text: str, level: int = 2) -> str:
    """A heading of plain text."""
    return f"<h{level}>{html.escape(text)}</h{level}>"


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text; ``kind`` is a class of STYLE: small, good or bad."""
    return f"<p{_class(kind)}>{html.escape(text)}</p>"


def bullets(texts: Iterable[str]) -> str:
    """A list of plain texts; nothing for none."""
    items = "".join(f"<li>{html.escape(text)}</li>" for text in texts)
    return f"<ul>{items}</ul>" if items else ""


def table(
    rows: Iterable[Sequence[str]], heads: Sequence[str] = (), numbers: Container[int] = (), *, named: bool = False
) -> str:
    """A table of plain texts: columns ``numbers`` are set as figures, the first as heads where rows are ``named``."""
    tags = ("th" if named else "td", "td")
    lines = ["".join(_cell("th", text, i in numbers) for i, text in enumerate(heads))] if heads else []
    lines += ["".join(_cell(tags[i > 0], text, i in numbers) for i, text in enumerate(row)) for row in rows]
    return f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"


def image(png: bytes, text: str) -> str:
    """A PNG; ``text`` stands where it cannot be shown."""
    return f'<img alt="{html.escape(text)}" src="data:image/png;base64,{base64.b64encode(png).decode()}">'


def picture(png: bytes, caption: str) -> str:
    """A PNG over its caption."""
    return f'<figure>{image(png, caption)}<figcaption class="small">{html.escape(caption)}</figcaption></figure>'


def video(mp4: bytes) -> str:
    """An MP4 that plays by itself, again and again."""
    source = base64.b64encode(mp4).decode()
    return f'<video controls autoplay loop muted playsinline src="data:video/mp4;base64,{source}"></video>'


def _cell(tag: str, text: str, is_number: bool) -> str:
    return f"<{tag}{_class('number' if is_number else '')}>{html.escape(text)}</{tag}>"


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""
