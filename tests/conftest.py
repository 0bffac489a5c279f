"""Options of the tests."""

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--all-wires", action="store_true", help="the whole conformance suite on every wire (15 minutes), not a third"
    )
