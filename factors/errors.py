"""The errors that this library raises; every one derives from `ObjectGraphError`."""


class ObjectGraphError(Exception):
    """Base of every error of `factors` and `objgraph`: catch this one to catch them all."""


class FactorError(ObjectGraphError, ValueError):
    """A factor was given, or has computed, something that must not reach the optimiser."""


class NotFiniteError(FactorError):
    """A factor has computed what is no number, as a step that is too long can make it do."""
