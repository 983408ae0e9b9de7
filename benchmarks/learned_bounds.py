"""How near what the fast tests learn comes to their bounds, with the arithmetic of other processors.

    python benchmarks/learned_bounds.py

PyTorch chooses by the processor how it adds up, so elsewhere a training of the same seed ends in slightly other
weights; here it is told to compute as on others. Writes docs/results/learned-bounds.{json,md}.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

from commands import write_and_show

FILES = ("tests/test_learning.py", "tests/test_transporter_learning.py", "tests/test_transporter_bags.py")
PROCESSORS: dict[str, dict[str, str]] = {
    "this one": {},
    "two threads": {"OMP_NUM_THREADS": "2"},
    "no vectors": {"ATEN_CPU_CAPABILITY": "default"},
    "AVX2": {"ATEN_CPU_CAPABILITY": "avx2"},
    "AVX2, oneDNN's too": {"ATEN_CPU_CAPABILITY": "avx2", "ONEDNN_MAX_CPU_ISA": "AVX2"},
}


def main() -> None:
    found = {name: bounded(settings) for name, settings in PROCESSORS.items()}
    rows = [
        {
            "test": test,
            "what": what,
            "bound": bound,
            **{name: found[name][test, what, bound] for name in found},
        }
        for test, what, bound in found["this one"]
    ]
    write_and_show(
        "learned-bounds",
        "What tests learn, and the bounds it has to stay below",
        rows,
        "`no vectors`: `ATEN_CPU_CAPABILITY=default`; `AVX2`: `=avx2`, and with `ONEDNN_MAX_CPU_ISA=AVX2`; `two "
        "threads`: `OMP_NUM_THREADS=2`, one in all others. All tests of these files passed everywhere.",
    )


def bounded(settings: dict[str, str]) -> dict[tuple[str, str, float], float]:
    """What the tests measure, by test, quantity and bound, on a processor told to compute like this."""
    with TemporaryDirectory() as folder:
        report = Path(folder, "report.xml")
        subprocess.run(
            [sys.executable, "-m", "pytest", *FILES, "-p", "no:cacheprovider", f"--junitxml={report}"],
            env={**os.environ, "OMP_NUM_THREADS": "1", **settings},
            stdout=sys.stderr,
            check=True,
        )
        cases = ElementTree.parse(report).iter("testcase")
        measured = [(case.get("name", ""), each) for case in cases for each in case.iter("property")]
    return {
        (test, each.get("name", ""), float(bound)): float(value)
        for test, each in measured
        for value, bound in [each.get("value", "").split(" of ")]
    }


if __name__ == "__main__":
    main()
