"""`baggie lab`: open the lab, say how to reach it, keep it going until Ctrl-C."""

from __future__ import annotations

import logging
import signal
from collections.abc import Callable

from baggie.files import write_text
from baggie.lab.faults import cause, check_fault
from baggie.lab.lab import Lab
from baggie.lab.web import STREAM, LabServer
from baggie.options.commissioning import LabOptions

_FILE = """\
# The virtual lab: a simulated workcell behind the interfaces of a real one (docs/lab.md).
arm:
  kind: franka
  host: {host}
  realtime: false
  speed: 1.0
camera:
  source: {camera}
  timeout_s: 20
bag:
  length_m: {bag.length_m}
  width_m: {bag.width_m}
  color: [{color}]
"""


def _print(text: str) -> None:
    print(text, flush=True)


def serve_lab(options: LabOptions, announce: Callable[[str], None] = _print) -> None:
    """Keep a lab going until Ctrl-C, or until the process is told to end. `announce` gets the workcell file's text.

    Raises `BaggieError` where an address cannot be had, or a fault is not one.
    """
    options.check()
    for name, after_s in options.faults():
        check_fault(name, after_s)
    logging.getLogger("franky_sim").setLevel(logging.CRITICAL)  # a client that hangs up is no news
    lab = Lab(options.cell, options.seed, options.host, options.pace, options.picture_size())
    server = LabServer(lab, options.camera_port)
    for name, after_s in options.faults():
        cause(name, lab, server.camera, after_s)
    text = workcell_text(lab, server)
    if options.out is not None:
        write_text(options.out, text)
    announce(text)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: lab.close())
    lab.run()
    server.close()


def workcell_text(lab: Lab, server: LabServer) -> str:
    """The workcell file that opens the lab."""
    bag = lab.bag
    color = ", ".join(str(value) for value in bag.color)
    return _FILE.format(host=lab.host, camera=server.address + STREAM, bag=bag, color=color)
