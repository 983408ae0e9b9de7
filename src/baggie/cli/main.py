"""`baggie <verb>`: thin. One function per verb; its options are the verb's own dataclass."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import tyro
from rich.console import Console

from baggie.cli.calibrate import calibrate, workcell
from baggie.cli.output import show
from baggie.collect import CollectOptions
from baggie.collect import collect as run_collect
from baggie.commissioning.doctor import DoctorOptions, as_table, examine, require_healthy
from baggie.commissioning.printed import PrintOptions, print_to_pdf
from baggie.data import contact_sheet, inspect_dataset
from baggie.data.summary import InspectOptions
from baggie.errors import BaggieError, BaggieWarning, UsageError, WriteError, explained
from baggie.evaluation.closed_loop import EvaluateOptions
from baggie.evaluation.closed_loop import evaluate as run_evaluate
from baggie.evaluation.validate import ValidateOptions
from baggie.evaluation.validate import validate as run_validate
from baggie.lab.options import LabOptions
from baggie.learning import TrainOptions
from baggie.learning import train as run_train
from baggie.policies.export import ExportOptions
from baggie.policies.export import export as run_export
from baggie.ravens.convert import ImportOptions
from baggie.ravens.convert import import_ravens as run_import_ravens
from baggie.report.report import ReportOptions
from baggie.report.report import report as run_report

DONE, FAILED, WRONG_USAGE, INTERRUPTED = 0, 1, 2, 130
_FORMAT_WARNING = warnings.formatwarning


def collect(options: CollectOptions, json: bool = False) -> None:
    """Let the robot make demonstrations by itself, unattended. The same command again goes on where it stopped.

    Example: baggie collect --task bag-place --attempts 300 --seed 0 --cell 0 --out recordings/bags

    Args:
        options: What to collect.
        json: Print the summary as one JSON object.
    """
    show(run_collect(options), json)


def inspect(options: InspectOptions, json: bool = False) -> None:
    """Say what is in a recording, and draw a contact sheet of it.

    Example: baggie inspect recordings/bags

    Args:
        options: Which recording, and where to draw.
        json: Print the summary as one JSON object.
    """
    data = options.data
    summary = inspect_dataset(data)
    trouble = None
    if summary["attempts"]:
        try:
            sheet = options.sheet or data / "contact-sheet.png"
            summary["contact_sheet"] = str(contact_sheet(data, sheet, options.columns))
        except WriteError as error:
            trouble = error
    show(summary, json)
    if trouble is not None and options.sheet is not None:
        raise trouble
    if trouble is not None:  # nobody asked for it: the recording is a colleague's perhaps, or the disk full
        warnings.warn(f"{trouble}; or give --sheet another place", BaggieWarning, stacklevel=1)


def import_ravens(folder: tyro.conf.Positional[Path], options: ImportOptions, json: bool = False) -> None:
    """Convert demonstrations of the Ravens benchmark into a recording. The same command again goes on.

    FOLDER is one of those that Ravens' demos.py writes, with action, color, depth, info and reward in it. Its three
    views become one picture from straight above, each action an attempt, each episode an episode.

    Example: baggie import-ravens stack-block-pyramid-train --out recordings/pyramid

    Args:
        folder: The folder of a task's demonstrations.
        options: Where to, and over which part of the table.
        json: Print what the recording holds then as one JSON object.
    """
    show(run_import_ravens(folder, options), json)


def train(options: TrainOptions, json: bool = False) -> None:
    """Teach a policy from a recording. The same command again goes on where it stopped.

    Example: baggie train --policy keypoint --data recordings/bags --out runs/keypoint

    Args:
        options: What to train.
        json: Print the metrics as one JSON object.
    """
    show(run_train(options), json)


def validate(options: ValidateOptions, json: bool = False) -> None:
    """Measure pick and place errors, in cm, on attempts a policy never learned from.

    Example: baggie validate --policy runs/keypoint --data recordings/bags --out runs/keypoint/validation

    Args:
        options: What to measure.
        json: Print the metrics as one JSON object.
    """
    show(run_validate(options), json)


def evaluate(options: EvaluateOptions, json: bool = False) -> None:
    """Run the whole loop on scenes nobody has seen, and measure how often the task is done.

    Example: baggie evaluate --policy runs/keypoint --task bag-place --episodes 100 --out runs/keypoint/evaluation

    Example: baggie evaluate --policy runs/pyramid --task block-pyramid --out runs/pyramid/evaluation

    Args:
        options: What to run.
        json: Print the metrics as one JSON object.
    """
    show(run_evaluate(options), json)


def report(options: ReportOptions, json: bool = False) -> None:
    """Put everything known about some runs on one self-contained page.

    Example: baggie report runs/keypoint runs/color-mask --out report.html

    Args:
        options: What to put on it.
        json: Print where the page is as one JSON object.
    """
    show({"report": str(run_report(options))}, json)


def export(options: ExportOptions, json: bool = False) -> None:
    """Write a trained policy as files that run without PyTorch, and check that it says the same.

    Example: baggie export --policy runs/keypoint --out exported/keypoint

    Args:
        options: What to export.
        json: Print what was written as one JSON object.
    """
    show(run_export(options), json)


def doctor(options: DoctorOptions, json: bool = False) -> None:
    """Check a workcell: camera, light, arm, calibrations; then, with leave, move slowly and touch something firm.

    Example: baggie doctor cell.yaml

    Args:
        options: Which workcell, and whether it may move.
        json: Print the findings as one JSON object.
    """
    findings = examine(options)
    if json:
        show({"findings": [asdict(finding) for finding in findings]}, json)
    else:
        Console().print(as_table(findings))
    require_healthy(findings)


def lab(options: LabOptions) -> None:
    """Run a virtual lab: a simulated workcell that is reached as a real one is. Ctrl-C ends it.

    Prints the workcell file that opens it.

    Example: baggie lab --out lab.yaml

    Args:
        options: What is in it, and where it is reached.
    """
    from baggie.lab.serve import serve_lab  # noqa: PLC0415 -- MuJoCo takes its time

    serve_lab(options, lambda text: print(text, flush=True))


def print_target(options: PrintOptions, json: bool = False) -> None:
    """Make a marker, a board or a goal card as a PDF at true size.

    Example: baggie print-target board --out board.pdf

    Args:
        options: What to print, and on what.
        json: Print where it is as one JSON object.
    """
    show(print_to_pdf(options), json)


VERBS: dict[str, Callable[..., None]] = {
    verb.__name__.replace("_", "-"): verb
    for verb in (
        collect,
        inspect,
        import_ravens,
        train,
        validate,
        evaluate,
        report,
        export,
        workcell,
        doctor,
        lab,
        calibrate,
        print_target,
    )
}


def main(arguments: list[str] | None = None) -> int:
    """Run a verb; the exit status: 0 done, 1 it could not be done, 2 wrong usage (by tyro, too), 130 interrupted."""
    warnings.formatwarning = _format_warning
    return _run(arguments)


def _format_warning(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, line: str | None = None
) -> str:
    """One line for what users should know; Python's own form for what developers should."""
    if issubclass(category, BaggieWarning):
        return f"warning: {' '.join(str(message).split())}\n"
    return _FORMAT_WARNING(message, category, filename, lineno, line)


def _run(arguments: list[str] | None) -> int:
    try:
        tyro.extras.subcommand_cli_from_dict(
            VERBS,
            prog="baggie",
            description="A robot that teaches itself to pick up and place soft things.",
            args=arguments,
            config=(
                tyro.conf.OmitArgPrefixes,
                tyro.conf.OmitSubcommandPrefixes,
                tyro.conf.FlagCreatePairsOff,
            ),
        )
    except (BaggieError, OSError) as error:
        return _failed(error)
    except ImportError as error:
        if (missing := explained(error)) is None:
            raise
        return _failed(missing)
    except KeyboardInterrupt as interruption:
        print(str(interruption) or "interrupted; the same command again goes on", file=sys.stderr)
        return INTERRUPTED
    return DONE


def _failed(error: Exception) -> int:
    """Say why in one line; the exit status."""
    print("error:", " ".join(str(error).split()), file=sys.stderr)
    return WRONG_USAGE if isinstance(error, UsageError) else FAILED


if __name__ == "__main__":
    sys.exit(main())
