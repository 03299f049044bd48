"""The paper's two tables in its own form beside its published figures, then medians and paired differences."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from operator import itemgetter
from typing import Any

from objgraph.bench.comparison.contenders.methods import METHODS
from objgraph.bench.comparison.objects.measure import WELL_RECONSTRUCTED
from objgraph.bench.comparison.objects.summary import WORST
from objgraph.bench.comparison.writing import published
from objgraph.bench.comparison.writing.grid import NONE, Cell, Grid, ranged, ranked, ranked_across
from objgraph.bench.comparison.writing.report import Entry

_RATES = ("pose_rate", "iou_rate", "chamfer_rate")
_ERRORS = ("translation\n(cm)", "rotation\n(deg)", "Chamfer\n(cm)")
_NAMES = ("9-DoF Pose", "IoU>0.25", "CD<0.2")
_MARKS = "best bold, second underlined, the published rows among themselves"


def all_tables(
    entries: Sequence[Entry], pairs: Sequence[Entry], methods: Sequence[str], data: str
) -> list[Grid]:
    """Every table of a comparison; `data` says in a few words what was measured."""
    tables = [rates_table(entries, methods, data), pearson_table(entries, methods, data)]
    tables += [intervals_table(entries, data), attainable_table(entries, data), medians_table(entries, data)]
    return [*tables, paired_table(pairs, data)] if pairs else tables


def rates_table(entries: Sequence[Entry], methods: Sequence[str], data: str) -> Grid:
    """Table I (table_quantitative_scanet): shares of objects that meet each of the three criteria."""
    found = {(e["contender"], e["category"], e["views"]): e for e in entries}
    categories = _unique(entries, "category")
    sections = []
    for views in sorted(_unique(entries, "views")):
        ours = [_rates(name, views, categories, found) for name in methods]
        theirs = [_published_rates(name, views, categories) for name in published.LABELS]
        known = views in published.RATES and set(categories) & published.OBJECTS.keys()
        for rows in [ours, theirs] if known else [ours]:
            sections.append(tuple(tuple(row) for row in ranked(rows)))
    header = (*("Views", "Methods"), *(f"{c.capitalize()}\n{name}" for c in categories for name in _NAMES))
    ours = ", ".join(f"{_count(entries, c)} {c}" for c in categories)
    theirs = ", ".join(f"{n} {c}" for c, n in published.OBJECTS.items())
    caption = f"Objects here: {ours}; {published.WHERE}: {theirs}. Failures count as wrong; {_MARKS}."
    return Grid(f"Table I: correct detection rates ({data})", header, tuple(sections), caption, words=2)


def intervals_table(entries: Sequence[Entry], data: str) -> Grid:
    """The rates with their bootstrap intervals, and what each method is given beside views, prior and start."""

    def texts(e: Entry) -> Iterator[str]:
        given = METHODS[e["method"]].given if e["method"] in METHODS else ()
        yield from (e["contender"], ", ".join(given) or NONE, str(e["n"]), str(e["n_shapes"]))
        yield from (ranged(e, rate, 1, 2) for rate in _RATES)

    caption = (
        "In brackets 95 % percentile bootstrap over distinct shapes; failures count as wrong. Given: what a method is told "
        "beside views, prior and start. The shared start knows floor and gravity; that of `@own` contenders is the mean shape "
        "by ICP over headings, which knows gravity alone, but for the graph's, which is the shared one."
    )
    header = ("Objects", "Method", "given", "n", "shapes", *_NAMES)
    return Grid(f"Rates with their intervals ({data})", header, _sections(entries, texts), caption, words=3)


def pearson_table(entries: Sequence[Entry], methods: Sequence[str], data: str) -> Grid:
    """Table II (table_uncertainty): the mean correlation of |SDF error| and its standard deviation, raw and in bins."""
    known = {e["contender"] for e in entries if e["pearson"] is not None}
    names = [name for name in methods if name in known]
    names += [name for name in published.PEARSON["chair"] if name not in names]
    found = {(e["contender"], e["category"], e["views"]): e for e in entries}
    sections = []
    for category in _unique(entries, "category"):
        rows = [
            [Cell(f"{category.capitalize()}, {_views(views)}, {words}")]
            + ranked_across([_pearson(found.get((name, category, views)), figure) for name in names])
            for views in sorted({e["views"] for e in entries if e["category"] == category})
            for figure, words in (("pearson", "10,000 points"), ("pearson_binned", "100 bins"))
        ]
        if category in published.PEARSON:
            theirs = [_number(published.PEARSON[category].get(name), faint=True) for name in names]
            words = f"{category.capitalize()}, {_views(published.UNCERTAINTY_VIEWS)}, {published.WHERE}"
            rows.append([Cell(words, faint=True), *ranked_across(theirs)])
        sections.append(tuple(tuple(row) for row in rows))
    theirs = ", ".join(f"{n} {c}" for c, n in published.UNCERTAINTY_OBJECTS.items())
    caption = (
        f"Mean over well-reconstructed objects, how many in brackets: {WELL_RECONSTRUCTED}; {published.WHERE}: "
        f"{theirs}, by a rule that it does not state, and it does not say over points or over bins of sigma. "
        f"{_MARKS.capitalize()}. Methods without standard deviations are left out."
    )
    header = ("Objects", *(_column(name) for name in names))
    return Grid(
        f"Table II: Pearson correlation of error and uncertainty ({data})", header, tuple(sections), caption
    )


def attainable_table(entries: Sequence[Entry], data: str) -> Grid:
    """How much of the correlation that its standard deviations allow an estimate has."""
    known = [e for e in entries if e["pearson_metres"] is not None]
    figures = ("pearson_metres", "pearson_metres_gaussian")
    rows = _section(known, lambda e: (e["contender"], *(ranged(e, name, 1, 2) for name in figures)))
    caption = (
        "In metres, over the points that are kept with each object. The second figure is what errors would have that are "
        "Gaussian with exactly these standard deviations: much more is not to be had without wider differences among them."
    )
    header = ("Objects", "Method", "Pearson", "of Gaussian errors")
    return Grid(f"Correlation and how much of it there could be ({data})", header, (rows,), caption, words=2)


def medians_table(entries: Sequence[Entry], data: str) -> Grid:
    """Continuous errors with their bootstrap intervals."""
    figures = (
        ("median_translation_m", 100, 1), ("median_rotation_deg", 1, 1), ("median_chamfer_m", 100, 2),
        ("seconds_cpu", 1, 1), ("start_seconds", 1, 1),
    )  # fmt: skip
    sections = _sections(
        entries,
        lambda e: (e["contender"], str(e["n"]), str(e["n_failed"]), *(ranged(e, *each) for each in figures)),
    )
    caption = (
        "In brackets 95 % percentile bootstrap over distinct shapes. A failure is infinitely wrong. Processor seconds of the "
        "estimation, of those that succeeded, and of finding its start: a method's time is both."
    )
    header = ("Objects", "Method", "n", "failed", *_ERRORS, "solve\n(s)", "start\n(s)")
    return Grid(f"Medians ({data})", header, sections, caption, words=2)


def paired_table(pairs: Sequence[Entry], data: str) -> Grid:
    """Differences of two methods on the same objects."""
    figures = (("median_translation_m", 100, 2), ("median_rotation_deg", 1, 2), ("median_chamfer_m", 100, 2))

    def texts(p: Entry) -> Iterator[str]:
        yield from (f"{p['a']} - {p['b']}", str(p["n"]), *(ranged(p, *each) for each in figures))
        yield f"{ranged(p, 'mean_pearson', 1, 3)} ({p['n_both_well']})"

    caption = (
        "Median difference on the same objects, below zero where the first method is better, with 95 % bootstrap over "
        f"distinct shapes. Errors count as {WORST['translation_m']:g} m, {WORST['rotation_deg']:g} degrees and "
        f"{WORST['chamfer_m']:g} m at most, failures as these. Pearson: mean difference over the objects (how many in "
        "brackets) that both reconstruct well, above zero where the first is better."
    )
    header = ("Objects", "Methods", "n", *_ERRORS, "Pearson")
    return Grid(f"Paired differences ({data})", header, _sections(pairs, texts), caption, words=2)


def calibration_tables(entries: Sequence[Entry], data: str) -> list[Grid]:
    """Boxes and surfaces: what share is covered, and by how much errors exceed their standard deviations."""
    shares = ("50 %", "90 %", "95 %")
    covered = ("coverage50", "coverage90", "coverage95")
    of_surface = (*(f"surface_{name}" for name in covered), "surface_nees", "surface_nll", "pearson_surface", "spearman_surface")  # fmt: skip

    def box(e: Entry) -> Iterator[str]:
        yield from (e["contender"], str(e["n"]), *(_figure(e, name) for name in ("wrong_modes", *covered)))
        yield ranged(e, "nees_per_dof", 1, 2)
        yield NONE if e["nees_chi2"] is None else "{:.2f} to {:.2f}".format(*e["nees_chi2"])
        yield from (_figure(e, "nll"), _figure(e, "sharpness", 4))

    surfaces = _section(entries, lambda e: (e["contender"], *(_figure(e, name) for name in of_surface)))
    known = [e for e in entries if "verdict_brier" in e]
    return [
        *([_with_calibration(known, data)] if known else []),
        Grid(
            f"Calibration of the 9-DoF box ({data})",
            ("Objects", "Method", "n", "wrong\nmode", *shares, "NEES / 9", "if it held", "NLL", "sharpness"),
            (_section(entries, box),),
            "Share of all objects whose true box lies in the ellipsoid of that probability; mean squared Mahalanobis error over 9 and negative "
            "log-likelihood (nats) of those in the right mode (heading within 45 degrees modulo symmetry), with 95 % bootstrap over shapes, "
            "and where that mean would be if the covariances held; sharpness: geometric mean of the nine standard deviations, median.",
            words=2,
        ),
        Grid(
            f"Calibration of the surface ({data})",
            ("Objects", "Method", *shares, "mean z²", "NLL", "Pearson", "Spearman"),
            (surfaces,),
            "Signed distance at points of the true surface over its standard deviation, the decoder's own added; means over "
            "well-reconstructed objects.",
            words=2,
        ),
    ]


def _with_calibration(entries: Sequence[Entry], data: str) -> Grid:
    """What the calibration that is shipped makes of them."""
    figures = (
        "coverage95_sides", "coverage50_calibrated", "coverage90_calibrated", "coverage95_calibrated", "heading95_calibrated",
        "coverage95_surface",
    )  # fmt: skip

    def texts(e: Entry) -> Iterator[str]:
        yield from (e["contender"], str(e["n_judged"]), *(_figure(e, name) for name in figures))
        yield _figure(e, "set_size", 4)
        yield from (_figure(e, name) for name in ("wrong_modes_outside", "verdict_brier"))
        yield NONE if e.get("verdict_brier_base") is None else f"{e['verdict_brier_base']:.2f}"
        yield from (_figure(e, name) for name in ("sure", "sure_right"))

    header = (
        "Objects", "Method", "n", "sides\n95 %", "50 %", "90 %", "95 %", "heading\n95 %", "surface\n95 %", "set size",
        "wrong mode\noutside", "Brier", "of the\nrate", "sure", "of them\nright",
    )  # fmt: skip
    caption = (
        "Boxes of all objects that were estimated in the set of all modes: with the sides' errors, then calibrated; set size: geometric mean of its standard "
        "deviations at 95 %, median. Brier score of the probability that a pose is right, beside that of the rate alone."
    )
    return Grid(f"Calibrated ({data})", header, (_section(entries, texts),), caption, words=2)


def stability_table(entries: Sequence[Entry], data: str) -> Grid:
    """How far estimates are the same again."""
    figures = (("spread_m", 100), ("spread_deg", 1), ("spread_extents_m", 100), ("spread_chamfer_m", 100))

    def texts(e: Entry) -> Iterator[str]:
        yield from (e["contender"], str(e["n"]), str(e["n_failed"]))
        yield from (NONE if e[name] is None else f"{factor * e[name]:.2f}" for name, factor in figures)
        yield NONE if e["threads_m"] is None else f"{100 * e['threads_m']:.2f}"
        yield _figure(e, "mode_changes")

    caption = (
        "Root mean square about an object's mean over five draws of points and rays and a run with two threads, median of the "
        "objects; two threads against one: the largest. Another mode: headings more than 45 degrees apart modulo symmetry, or "
        "0.1 less of the true surface within 2 cm."
    )
    header = (
        "Objects", "Method", "n", "failed", "centre\n(cm)", "heading\n(deg)", "extents\n(cm)", "Chamfer\n(cm)",
        "threads\n(cm)", "another\nmode",
    )  # fmt: skip
    return Grid(f"The same objects again ({data})", header, _sections(entries, texts), caption, words=2)


def _sections(
    entries: Sequence[Entry], texts: Callable[[Entry], Iterable[str]]
) -> tuple[tuple[tuple[Cell, ...], ...], ...]:
    """A section a category and number of views."""
    groups = groupby(entries, key=itemgetter("category", "views"))
    return tuple(_section(group, texts) for _, group in groups)


def _section(
    entries: Iterable[Entry], texts: Callable[[Entry], Iterable[str]]
) -> tuple[tuple[Cell, ...], ...]:
    """A row an entry: what objects it is of, then its texts."""
    return tuple(
        (Cell(f"{e['category'].capitalize()}, {_views(e['views'])}"), *map(Cell, texts(e))) for e in entries
    )


def _rates(
    name: str, views: int, categories: Sequence[str], found: Mapping[tuple[str, str, int], Entry]
) -> list[Cell]:
    cells = [Cell(str(views)), Cell(published.label(name))]
    for category in categories:
        entry = found.get((name, category, views))
        cells += [_number(None if entry is None else entry[rate]) for rate in _RATES]
    return cells


def _published_rates(name: str, views: int, categories: Sequence[str]) -> list[Cell]:
    rates = published.RATES.get(views, {}).get(name, {})
    cells = [Cell(str(views), faint=True), Cell(f"{published.LABELS[name]} ({published.WHERE})", faint=True)]
    for category in categories:
        cells += [_number(value, faint=True) for value in rates.get(category, (None, None, None))]
    return cells


def _pearson(entry: Entry | None, figure: str) -> Cell:
    if entry is None or entry[figure] is None:
        return Cell(f"{NONE} (0)" if entry is not None else NONE)
    return Cell(f"{entry[figure]:.3f} ({entry['n_well']})", entry[figure])


def _number(value: float | None, faint: bool = False) -> Cell:
    return Cell(NONE if value is None else f"{value:.3f}", value, faint=faint)


def _column(name: str) -> str:
    return published.label(name).replace(" (", "\n(")


def _views(count: int) -> str:
    return "1 view" if count == 1 else f"{count} views"


def _count(entries: Sequence[Entry], category: str) -> int:
    return max(e["n"] for e in entries if e["category"] == category)


def _unique(entries: Sequence[Entry], name: str) -> list[Any]:
    return list(dict.fromkeys(e[name] for e in entries))


def _figure(entry: Entry, name: str, digits: int = 2) -> str:
    return NONE if entry[name] is None else f"{entry[name]:.{digits}f}"
