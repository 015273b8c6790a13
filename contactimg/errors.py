"""The exceptions of contactimg, each carrying one sentence a physicist can act on."""

__all__ = ["ContactimgError", "ConvergenceError", "FrameError", "InputError", "ModelRangeError"]


class ContactimgError(Exception):
    """Base of every exception that contactimg raises on purpose."""


class InputError(ContactimgError, ValueError):
    """What was handed in breaks a rule: the message names what, the rule, the value and the remedy."""


class FrameError(InputError):
    """One frame cannot be read or measured; the other frames of its series are not concerned."""


class ModelRangeError(InputError):
    """The problem lies outside the range in which the model has one meaningful solution."""


class ConvergenceError(ContactimgError, RuntimeError):
    """An iterative solver stopped above its tolerance; the message names residual, tolerance and remedy."""
