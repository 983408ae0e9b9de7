#!/usr/bin/env bash
# franky and libfranka: connecting to a robot makes the connecting thread a real-time thread, for good, even when asked not to.
#
# `RealtimeConfig.Ignore` says that no real-time priority is needed. All the same the constructor of `franky.Robot` raises
# the thread that calls it to SCHED_FIFO, at the highest priority, wherever that is permitted (root, or an `rtprio` limit
# as Franka recommends), and leaves it there. Motions run in threads of their own. What the program starts later, a camera's
# thread or a process that trains, inherits that priority; one that waits by spinning then starves what it waits for.
set -euo pipefail
folder=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check franky-control==2.0.0 franky-sim==1.0.4 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import os
import sys

try:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(os.sched_get_priority_max(os.SCHED_FIFO)))
except PermissionError:
    sys.exit("needs the right to real-time priorities: run it as root, or with an rtprio limit of 99")
PYTHON
"$folder/venv/bin/franky-sim" -s mujoco --hostname 127.0.0.1 >"$folder/server.log" 2>&1 &
"$folder/venv/bin/python" - <<'PYTHON'
import os
import subprocess
import sys
import threading
import time
from importlib.metadata import version

import franky

NAMES = {os.SCHED_OTHER: "ordinary", os.SCHED_FIFO: "real-time"}
print(f"franky-control {version('franky-control')}, franky-sim {version('franky-sim')}")


def priority():
    return NAMES[os.sched_getscheduler(0)], os.sched_getparam(0).sched_priority


def connect():
    for _ in range(120):
        try:
            return franky.Robot("127.0.0.1", realtime_config=franky.RealtimeConfig.Ignore)
        except franky.NetworkException:
            time.sleep(0.5)
    sys.exit("franky-sim does not answer")


in_a_thread = []
thread = threading.Thread(target=lambda: (connect(), in_a_thread.append(priority())))
before = priority()
thread.start()
thread.join()
beside = priority()
robot = connect()
after = priority()
ask = "import os; print(os.sched_getscheduler(0) == os.SCHED_FIFO)"
child = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True).stdout.strip()
print("before connecting:", before)
print("a thread that connected:", in_a_thread[0], "and the one that started it:", beside)
print("having connected:", after)
print("a process begun then is real-time, too:", child)
assert before == beside == ("ordinary", 0)
assert in_a_thread[0] == after == ("real-time", os.sched_get_priority_max(os.SCHED_FIFO))
assert child == "True"
print("seen: connecting raises the connecting thread to the highest real-time priority, and leaves it there")
PYTHON
