"""Options of the tests."""

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--all-wires",
        action="store_true",
        help="every trial on every wire, with strict bounds: 15 minutes on a quiet machine",
    )
