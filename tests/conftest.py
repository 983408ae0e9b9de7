"""What holds for all tests: Ctrl-C is heard however they were started, and nothing here is about speed.

Laws are tried on a few examples, the same everywhere, so that a new machine is not told red by luck;
`--hypothesis-profile thorough` takes many, which are others each time.
"""

import os
import signal
from collections.abc import Callable

import pytest
from hypothesis import settings

# A shell that starts something with & makes it deaf to Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)
settings.register_profile("quick", deadline=None, max_examples=25, derandomize=True)
settings.register_profile("thorough", deadline=None, max_examples=200)
settings.load_profile("quick")

MAY_ALWAYS_SKIP = (
    "tests/test_camera_k4a.py",
    "tests/test_drivers.py::test_every_camera_keeps_the_contract[k4a]",
)
"""What needs a maker's SDK that no registry has. Anything else is skipped only where it may not be installed."""


def pytest_sessionfinish(session: pytest.Session) -> None:
    """With NO_SKIPS, set where everything can be installed to check a change, a test that does not run is a failure."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is None or not os.environ.get("NO_SKIPS"):
        return
    skipped = {report.nodeid for report in reporter.stats.get("skipped", ())}
    for node in sorted(node for node in skipped if not node.startswith(MAY_ALWAYS_SKIP)):
        reporter.write_line(f"skipped, though everything can be here: {node}", red=True)
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


@pytest.fixture
def below(record_property: Callable[[str, object], None]) -> Callable[[str, float, float], None]:
    """`below(what, value, bound)` asserts it of what was learned, and records how near it came.

    `benchmarks/learned_bounds.py` makes a table of that.
    """

    def check(what: str, value: float, bound: float) -> None:
        record_property(what, f"{float(value):.9g} of {bound:g}")
        assert value < bound, what

    return check
