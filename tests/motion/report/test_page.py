"""report.html: one file that shows what it should."""

import base64
import io
import re

import matplotlib.image
import numpy as np
import pytest

from motion.human.motion import HumanMotion
from motion.report.labels import figure_text
from motion.report.page import report_page
from tests.motion.report.verdicts import verdict_of
from tests.view.test_page import Seen


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch):
    monkeypatch.setenv("KATA_RENDERER", "software")
    monkeypatch.setattr("motion.report.page.STRIP_SIZE_PX", 40)


def pictures_of(seen: Seen) -> dict[str, np.ndarray]:
    """Caption -> pixels."""
    sources = {
        attrs["alt"]: attrs["src"].removeprefix("data:image/png;base64,") for tag, attrs in seen.tags if tag == "img"
    }
    return {name: matplotlib.image.imread(io.BytesIO(base64.b64decode(source))) for name, source in sources.items()}


def test_the_page_holds_everything_and_needs_nothing(toy_clip, toy, record_of):
    text = report_page(record_of(toy_clip(), robot=toy))
    seen = Seen(text)
    assert seen.balanced
    heads = re.findall(r"<h2>(.*?)</h2>", text)
    assert heads == ["The written clip", "The filter", "Where it comes from", "The robot", "Before and after",
                     "Balance", "Feet", "Joint angles", "Joint speeds"]  # fmt: skip
    links = [attrs[name] for _, attrs in seen.tags for name in ("src", "href") if name in attrs]
    assert len(links) == 6 and all(link.startswith("data:image/png") for link in links)
    assert all(picture.std() > 0.0 for picture in pictures_of(seen).values())
    assert "Trackable." in seen.text and "assumed so" in seen.text and "Motion: walk<1>" in seen.text


def test_a_rejected_motion_without_a_clip_says_why(robot, record_of, standing_clip):
    clip = standing_clip()
    points = np.random.default_rng(0).normal(0.8, 0.1, (5, 22, 3))
    quat = np.tile([1.0, 0.0, 0.0, 0.0], (5, 22, 1))
    person = HumanMotion(fps=10.0, pos_w=points, quat_wxyz=quat, sole_w=np.zeros((5, 2, 4, 3)))
    nothing = {"after": None, "clip": None, "clip_verdict": None}
    record = record_of(clip, **nothing, before=person, input_verdict=verdict_of(5, (2,), "it floats"), failure="no way")
    seen = Seen(report_page(record))
    assert seen.balanced
    assert {"Not trackable:", "input: it floats", "no clip: no way", "There is none."} <= set(seen.text)
    assert len(pictures_of(seen)) == 2  # as read, and its balance


def test_figures_for_people():
    assert figure_text(3.14159) == "3.1" and figure_text(4) == "4" and figure_text(None) == "none"
    assert figure_text({}) == "0" and figure_text({"a + b": 2, "c + d": 3}) == "5 (a + b: 2; c + d: 3)"
