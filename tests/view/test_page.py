"""Pages are whole and show texts as they are."""

import base64
from html.parser import HTMLParser

import pytest

from view import page


class Seen(HTMLParser):
    """Tags with their attributes, text, and whether every tag was closed in order."""

    VOID = ("meta", "img", "br")

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.text, self.balanced = [], [], [], True
        self.feed(text)
        self.balanced &= not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        self.balanced &= bool(self.open) and self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def test_texts_are_shown_and_never_obeyed():
    rude = '<script>alert("&")</script>'
    parts = [
        page.heading(rude), page.paragraph(rude, "bad"), page.bullets([rude]), page.table([(rude,)], (rude,)),
        page.picture(b"x", rude),
    ]  # fmt: skip
    seen = Seen(page.whole_page(rude, "".join(parts)))
    assert seen.balanced
    assert "script" not in [tag for tag, _ in seen.tags]
    assert seen.text.count(rude) == 7  # title, heading, paragraph, bullet, head, cell, caption
    assert [attrs["alt"] for tag, attrs in seen.tags if tag == "img"] == [rude]


@pytest.mark.parametrize(
    ("made", "tag", "kind"),
    [(page.picture(b"\x89PNG", "a"), "img", "image/png"), (page.video(b"mp4"), "video", "video/mp4")],
)
def test_pictures_and_videos_are_inside(made, tag, kind):
    (source,) = [attrs["src"] for name, attrs in Seen(made).tags if name == tag]
    head, content = source.split(",")
    assert head == f"data:{kind};base64"
    assert base64.b64decode(content) in (b"\x89PNG", b"mp4")


def test_tables_mark_figures():
    seen = Seen(page.table([("a", "1"), ("b", "2")], ("name", "value"), numbers=(1,)))
    assert [attrs.get("class") for tag, attrs in seen.tags if tag in ("th", "td")] == [None, "number"] * 3
    assert page.bullets([]) == ""


def test_named_rows_begin_with_a_head():
    seen = Seen(page.table([("a", "1"), ("b", "2")], numbers=(1,), named=True))
    cells = [(tag, attrs.get("class")) for tag, attrs in seen.tags if tag in ("th", "td")]
    assert cells == [("th", None), ("td", "number")] * 2


def test_a_page_may_have_more_style():
    text = page.whole_page("a", "b", ".c { color: red; }")
    assert page.STYLE + ".c { color: red; }</style>" in text
