"""Judge a policy in a closed loop, and put all that is known about it on one page.

Shows an evaluation in Python, and the report of it: one file that loads nothing, to mail or to archive. Scenes come
from a random stream that no collection ever uses. Stopped, the same program goes on where it was; with more episodes it
adds to what is there. Needs the policy that `make demo` leaves behind.

Prints the success rate with its 95% interval, and where the page is:

    2 of 2 bags within 2 cm of their goals (34% to 100%), 0.4 cm off on average
    open runs/examples/report.html
"""

from __future__ import annotations

import sys
from pathlib import Path

from baggie.evaluation.closed_loop import EvaluateOptions, evaluate
from baggie.options.evaluating import ReportOptions
from baggie.report.report import report

POLICY = Path("demo/keypoint")
OPTIONS = EvaluateOptions(
    policy=str(POLICY), out=Path("runs/examples/evaluation"), episodes=2, workers=1, film=0
)


def main() -> None:
    """Two episodes, and their page."""
    if not POLICY.is_dir():
        sys.exit(f"error: no policy in {POLICY}; make one first: make demo")
    metrics = evaluate(OPTIONS)
    success = metrics["success"]
    done = round(success["rate"] * success["n"])
    print(
        f"{done} of {success['n']} bags within 2 cm of their goals ({success['low']:.0%} to {success['high']:.0%}), "
        f"{metrics['distance_cm']['mean']:.1f} cm off on average"
    )
    page = report(ReportOptions((OPTIONS.out,), Path("runs/examples/report.html")))
    print(f"open {page}")


if __name__ == "__main__":
    main()
