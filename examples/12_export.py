"""Export a policy as ONNX, to plan where there is no PyTorch.

Shows what `baggie export` does: the network and all that is computed from it become one file, and before anything is
written its outputs are compared with PyTorch's. Needs the policy that `make demo` leaves behind, and
`pip install "onnx>=1.17" "onnxruntime>=1.20"`.

Prints where it lies, and how far off from PyTorch it is at most:

    runs/examples/exported/policy.onnx, 0.6 MB
    off from PyTorch by at most 1.2e-07 (xy, metres), 4.3e-07 (yaw, radians)
"""

from __future__ import annotations

import sys
from pathlib import Path

from baggie.errors import BaggieError
from baggie.options.evaluating import ExportOptions
from baggie.policies.export import export

POLICY = Path("demo/keypoint")
OPTIONS = ExportOptions(policy=str(POLICY), out=Path("runs/examples/exported"))


def main() -> None:
    """Export, and say how exact it is."""
    if not POLICY.is_dir():
        sys.exit(f"error: no policy in {POLICY}; make one first: make demo")
    try:
        told = export(OPTIONS)
    except BaggieError as error:  # onnx is not installed: the line says what to do
        sys.exit(f"error: {error}")
    print(f"{told['exported']}, {told['size_mb']:.1f} MB")
    off = told["largest_difference"]
    print(f"off from PyTorch by at most {off['xy']:.1e} (xy, metres), {off['yaw']:.1e} (yaw, radians)")


if __name__ == "__main__":
    main()
