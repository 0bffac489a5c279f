"""The prior's fit has noise of its own, whatever bounds the learner's noise has."""

import pytest

from tests.train.worlds import g1, swaying_reference
from train.config import check, compose_document
from train.priors import build


@pytest.mark.parametrize(("overrides", "expected"), [((), 0.15), (("prior.fit_noise_std=0.2",), 0.2)])
def test_fit_noise_is_a_key_of_its_own(monkeypatch, overrides, expected):
    seen = []
    monkeypatch.setattr(build, "fit_estimate", lambda *_, noise_std, **__: seen.append(noise_std))
    document = compose_document(
        [
            "motion=none",
            "prior.kind=feedforward",
            "prior.aim=reference",
            "learner.noise_std_range=[0.01,2.0]",
            *overrides,
        ]
    )
    robot = g1()
    build.prior_of(check(document), robot, swaying_reference(robot, 0.5), progress=lambda line: None)
    assert seen == [expected]
