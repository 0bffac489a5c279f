"""Actors of these tests."""

import pytest

from tests.sim2sim.toys import write_still_actor


@pytest.fixture(scope="session")
def still(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(write_still_actor(tmp_path_factory.mktemp("still") / "actor.onnx"))
