"""The back-end's typed errors; each message names the file, frame or object and what to do."""

from factors.errors import FactorError, ObjectGraphError


class ConfigError(ObjectGraphError, ValueError):
    """A file of settings cannot be read, or holds what is no setting or no value of one."""


class DatasetError(ObjectGraphError, ValueError):
    """A data set's file is missing, truncated, or holds what it must not."""


class ObservationError(ObjectGraphError, ValueError):
    """A frame or mask cannot be used to observe an object."""


class InitialisationError(ObjectGraphError):
    """No initial pose could be found for an object."""


class PriorError(ObjectGraphError, ValueError):
    """A shape prior is missing, corrupt, or does not fit the request."""


class SolveError(ObjectGraphError):
    """The optimisation failed; the message names the object or the key."""


class ActiveVisionError(ObjectGraphError, ValueError):
    """No next view can be chosen: there is no candidate, or no object that could be asked about."""


class CovarianceError(ObjectGraphError, ValueError):
    """A covariance is no covariance, or not of what it is said to be."""


class GeometryError(ObjectGraphError, ValueError):
    """A shape that is none: a box without volume."""


class EvaluationError(ObjectGraphError, ValueError):
    """An estimate or a ground truth cannot be measured: its mesh is empty or flat, or its pose is no pose."""


class SegmentationError(ObjectGraphError, ValueError):
    """Images cannot be segmented: the library or the weights are missing, or the image is none."""


class MapError(ObjectGraphError, ValueError):
    """A saved map cannot be read or written."""


class OutputError(ObjectGraphError):
    """A picture or a document cannot be written."""


class ProcessError(ObjectGraphError):
    """A process that was at a piece of the work died, or could not send what came of it."""


class ViewError(ObjectGraphError, ValueError):
    """The viewer's package is missing, it cannot be started, or a recording cannot be made or written."""


__all__ = [
    "ActiveVisionError",
    "ConfigError",
    "CovarianceError",
    "DatasetError",
    "EvaluationError",
    "FactorError",
    "GeometryError",
    "InitialisationError",
    "MapError",
    "ObjectGraphError",
    "ObservationError",
    "PriorError",
    "ProcessError",
    "SegmentationError",
    "SolveError",
    "ViewError",
]
