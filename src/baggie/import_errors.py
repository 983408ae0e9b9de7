"""What a package that cannot be imported means for the user."""

from __future__ import annotations

from baggie.errors import BaggieError
from baggie.system_libraries import providers, remedy

_RUINED_MUJOCO = (
    "MuJoCo here is not whole, as pip leaves it when version 4 replaces a version 3. Give Baggie an environment of "
    "its own (python3 -m venv), or repair this one: pip install --force-reinstall --no-deps mujoco mujoco-core "
    "mujoco-studio (what needs MuJoCo 3 there, such as robosuite 1.5.2, stops working then)"
)


def explained(error: ImportError) -> BaggieError | None:
    """One line on a library of the system that is missing, or on MuJoCo without its core; None for anything else."""
    text = str(error)
    if needs := list(providers(text)):
        names = ", ".join(need.name for need in needs)
        return BaggieError(f"{names} is not on this machine: {remedy(needs)}")
    if "mujoco" in text.lower() or (error.name or "").startswith("mujoco"):
        return BaggieError(_RUINED_MUJOCO)
    return None
