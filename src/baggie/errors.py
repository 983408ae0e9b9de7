"""Errors a user can act on: each says what was expected, what came, and what to do next."""


class BaggieError(Exception):
    """Something could not be done; the message is one line fit for `error: ...` on a terminal."""


class UsageError(BaggieError):
    """What was asked is out of range, or does not go together; nothing was begun."""


class LimitError(BaggieError):
    """A motion would have left the workcell's limits; nothing was sent to the arm."""


class ReachError(BaggieError):
    """The arm cannot reach a pose, or did not get there."""


class ArmError(BaggieError):
    """The arm does not do what it is told: not found, link lost, stopped, or in an error that needs a person."""


class StuckError(ArmError):
    """An arm that only a person can, or may, set going again: nothing tries it any further by itself."""


class CameraError(BaggieError):
    """The camera gave no (fresh) picture."""


class DataError(BaggieError):
    """A file of a recording or a checkpoint is missing, cut off, or of another kind than asked for."""


class WriteError(DataError):
    """A file cannot be written: the disk is full, or it may only be read."""


class CalibrationError(BaggieError):
    """A calibration that cannot be trusted, or is of another camera; nothing was saved or used."""


class BumpedError(BaggieError):
    """The camera or the table is no longer where it was when the workcell was calibrated."""


class UnsureError(BaggieError):
    """A plan is less sure than the workcell asks for; nothing has moved."""


class BaggieWarning(UserWarning):
    """Something a user should know that stops nothing; the message is one line fit for `warning: ...` on a terminal."""
