"""What a calibration says of one object."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

from factors import checks
from objgraph.errors import CovarianceError

SHARES = checks.Range(0, 1)
SURE = 0.9
WORDS = ((SURE, "sure"), (0.7, "likely"), (0.4, "doubtful"), (0.0, "poor"))
"""From which probability on a pose is called so."""


@dataclass(frozen=True)
class Trust:
    """The verdict on an object, and how much its covariances have to be widened.

    Raises:
        CovarianceError: a probability is none, or a factor is not positive.
    """

    pose: float
    """Probability that its pose is right: the paper's criterion, 20 cm, 20 degrees and 20 %."""
    shape: float
    """Probability that its Chamfer distance is below 3 cm."""
    why: tuple[str, ...] = ()
    """What speaks against it, the worst first; empty where nothing does by much."""
    widening: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Of `box`, `heading` and `surface`, by level in per cent: the factor on the variances that the map gives it (boxes and headings: those
    of `MappedObject.box_modes`) at which sets of that level hold as many as they say."""
    evidence: Mapping[str, float] = field(default_factory=dict)
    """What it is judged by (`Evidence`)."""
    calibration: str = ""
    """Digest of the calibration that says so."""

    def __post_init__(self) -> None:
        for name in ("pose", "shape"):
            checks.number(f"the probability of a right {name}", getattr(self, name), SHARES, CovarianceError)
        object.__setattr__(self, "why", checks.tuple_of("the reasons", self.why, str, CovarianceError))
        checks.instance("the calibration's digest", self.calibration, str, CovarianceError)
        for name, value in checks.instance("the evidence", self.evidence, Mapping, CovarianceError).items():
            checks.number(f"the evidence '{name}'", value, error=CovarianceError)
        for name, levels in checks.instance("the widening", self.widening, Mapping, CovarianceError).items():
            where = f"the widening of {name}"
            for level, factor in checks.instance(where, levels, Mapping, CovarianceError).items():
                checks.number(f"{where} at {level} %", factor, checks.POSITIVE, CovarianceError)

    @property
    def word(self) -> str:
        """`sure`, `likely`, `doubtful` or `poor`."""
        return next(word for least, word in WORDS if self.pose >= least)

    @property
    def is_poor(self) -> bool:
        return self.word == WORDS[-1][1]

    @property
    def percent(self) -> int:
        """The pose's probability as it is shown: never whole."""
        return min(max(round(100 * self.pose), 1), 99)

    def to_json(self) -> dict[str, object]:
        return {**asdict(self), "why": list(self.why)}
