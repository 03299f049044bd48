"""What an examination gives: facts to read, and findings to act on."""

from dataclasses import dataclass

from objgraph.errors import ObjectGraphError


@dataclass(frozen=True)
class Finding:
    """Something that is wrong, or, as a note, that is good to know."""

    where: str
    """File, frame, object or package."""
    what: str
    do: str = ""
    """What to do; empty where `what` says it, as a typed error does."""
    note: bool = False

    @staticmethod
    def of(error: ObjectGraphError, where: str) -> "Finding":
        """A typed error: it names the file and says what to do."""
        return Finding(where, str(error))


@dataclass(frozen=True)
class Section:
    """What is known of one thing."""

    title: str
    rows: tuple[tuple[str, str], ...] = ()
    """Label and value."""
    findings: tuple[Finding, ...] = ()

    @property
    def wrong(self) -> tuple[Finding, ...]:
        """The findings that are no notes."""
        return tuple(finding for finding in self.findings if not finding.note)


def listed(names: list[str], most: int = 3) -> str:
    """The first few names."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
