"""What views that the graph's covariance chooses are worth, beside random and even ones.

    python -m objgraph.bench.active --out out/active --objects 50 --jobs 2

Each object stands in a room of its own and is seen once. Then the next view is chosen among cameras on the reachable half of
a ring about it, held 1.2 to 1.6 m high: by the information that the graph expects of each, at random, or as far from each other
as can be. After each view the object is estimated anew, as a map would. `metrics.json`: how many views chance and even
spreading need for the mean error of surfaces (`views_*`) and of the boxes' corners (`views_*_box`: the mean over all headings that
the estimate leaves, by their probabilities; `*_right`: over objects that no policy ever has in a wrong heading)
that the expected information reaches with four, the first among them, where `reached` says whether they do at all and `interval` is
95 % of bootstrap draws of objects; and how well expected and
realised information go together, over all views and over those after which the object stands as before (within 45
degrees). Finished objects are not run again.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import gtsam
import matplotlib.pyplot as plt
import numpy as np
import tyro
from rich.progress import track

from factors.state import ObjectState
from objgraph.active.cameras import reachable
from objgraph.active.next_view import Criterion, NextViewConfig, ViewGain, next_views
from objgraph.active.target import Target, target
from objgraph.atomic import write_file
from objgraph.bench.comparison.objects.calibration import RIGHT_MODE_DEG
from objgraph.bench.places import half_ring, spread_out
from objgraph.bench.views_needed import (
    Row,
    bootstrap,
    mean_errors,
    objects_of,
    seen_by_all,
    views_needed,
    within,
)
from objgraph.bench.worlds.cases import UP, BenchmarkConfig, Case, World, synthetic_cases
from objgraph.bench.worlds.meshes import ShapeSet
from objgraph.covariance.box import box_pose
from objgraph.covariance.box_modes import box_modes
from objgraph.errors import ObjectGraphError, ObservationError
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.task import Estimate, EstimationTask
from objgraph.graph.builder import ObjectBuilder
from objgraph.graph.initialise import first_states
from objgraph.maps.pipeline import scene_floor
from objgraph.metrics.box_error import box_error, corners_m
from objgraph.metrics.objects import evaluate_object
from objgraph.observation.frames import ListedFrames, Scan
from objgraph.observation.sampling import ObjectView, observe
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.registry import load_prior
from objgraph.priors.shape_prior import ShapePrior
from objgraph.show.next_view import sphere_picture
from objgraph.synthetic.camera import intrinsics
from objgraph.synthetic.faults import Difficulty
from objgraph.work import Workers, spread

GOAL = 4
"""Views of the policy that the others are measured against."""
TARGET = 1
POLICIES = ("next_best", "random", "even")


@dataclass
class Arguments:
    out: Path
    """Where metrics.json, the rows and the pictures go."""
    objects: int = 4
    """Half of them chairs, half tables; one is a chair."""
    jobs: int = 1
    """Objects at the same time."""
    seed: int = 0
    """Of objects, rooms and noise."""
    difficulty: Difficulty = "clean"
    """Which faults scans have."""
    shapes: ShapeSet = "families"
    """Which shapes: the families, or of `meshes` those held out."""
    meshes: Path | None = None
    """A folder with a subfolder of CAD meshes for each category."""
    candidates: int = 60
    """Cameras to choose among, at most."""
    distance: float = 1.9
    """Of the cameras from the object's middle, along the floor, metres."""
    most: int = 6
    """Views that chance and even spreading get: half as many again as the policy."""
    criterion: Criterion = "corners"
    """What the next view is chosen for."""


@dataclass
class Subject:
    """One object to be looked at."""

    case: Case
    world: World
    prior: ShapePrior
    floor: float | None
    cameras: list[gtsam.Pose3]
    """Those to choose among."""
    first: ObjectView

    def look(self, camera: gtsam.Pose3, number: int) -> ObjectView | None:
        """Take a picture and what it shows of the object; None where that is next to nothing."""
        rng = np.random.default_rng([self.case.seed, self.case.index, number])
        try:
            return observe(self.world.frame(camera, str(number), rng), TARGET, seed=number)
        except ObservationError:
            return None

    def estimate(self, views: Sequence[ObjectView]) -> Estimate:
        """From all views and nothing else."""
        first = first_states(self.prior, views, ObjectBuilder(up_world=UP, floor=self.floor))
        task = EstimationTask(
            self.case.id, self.prior, first.states, tuple(views), UP, self.floor, chances=first.chances
        )
        (result,) = GraphEstimator().estimate([task])
        if isinstance(result, ObjectGraphError):
            raise result
        return result

    def known(self, estimate: Estimate, views: Sequence[ObjectView]) -> Target:
        assert estimate.covariance is not None
        seen_from = [view.T_world_camera for view in views]
        return target(
            self.case.id, self.prior, estimate.state, estimate.covariance,
            seen_from=seen_from, turns=estimate.turns,
        )  # fmt: skip

    def measure(self, estimate: Estimate) -> dict[str, Any]:
        """Against the truth, of which nothing else here knows."""
        assert estimate.covariance is not None
        state, truth = estimate.state, self.world.truth
        mesh = extract_mesh(self.prior.decoder, state.code)
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        of_mesh = evaluate_object(state.T_world_object.matrix(), state.scale, vertices, faces, truth)
        box = box_pose(self.prior, state, estimate.covariance, vertices)
        modes = box_modes(box, state, estimate.turns)
        corners = sum(mode.probability * corners_m(mode.box, box_error(mode.box, truth)) for mode in modes)
        return {**asdict(of_mesh), "box_m": corners}


def subject(case: Case, arguments: Arguments) -> Subject:
    """The object and its first view; cameras about where that view sees it."""
    world, prior = case.world(), load_prior(case.category)
    rng = np.random.default_rng([case.seed, case.index, 0])
    frame = world.frame(world.first_camera(), "0", rng)
    view = observe(frame, TARGET)
    floor = scene_floor(
        Scan(case.id, ListedFrames([frame]), (case.instance,), UP)
    )  # by what has been seen, as all else
    middle, first = np.median(view.points_world, axis=0), view.T_world_camera.translation()
    ring = half_ring(middle, first, world.floor, arguments.distance, arguments.candidates, rng)
    held = reachable(ring, world.can_hold)
    return Subject(case, world, prior, floor, held, view)


def ranked(known: Target, cameras: list[gtsam.Pose3], criterion: Criterion) -> list[ViewGain]:
    return next_views([known], cameras, NextViewConfig(intrinsics()), criterion=criterion)


def realised(before: Estimate, after: Estimate) -> float:
    """Nats by which a view has narrowed pose, scale and code."""
    assert before.covariance is not None
    assert after.covariance is not None
    spreads = [np.linalg.slogdet(each.covariance.matrix)[1] for each in (before, after) if each.covariance]
    return 0.5 * (spreads[0] - spreads[1])


def turned(before: ObjectState, after: ObjectState) -> float:
    """Angle between two poses of an object, degrees."""
    between = before.T_world_object.rotation().between(after.T_world_object.rotation())
    return float(np.degrees(np.linalg.norm(gtsam.Rot3.Logmap(between))))


def row(item: Subject, policy: str, views: int, estimate: Estimate, **more: float) -> dict[str, Any]:
    return {"object": item.case.id, "policy": policy, "views": views, **item.measure(estimate), **more}


def one_by_one(item: Subject, policy: str, begun: Estimate, arguments: Arguments) -> list[dict[str, Any]]:
    """A view at a time: the next best, or any."""
    rng = np.random.default_rng([item.case.seed, item.case.index, 1])
    views, estimate, left, rows = [item.first], begun, list(item.cameras), []
    most = GOAL if policy == "next_best" else arguments.most
    while len(views) < most:
        order = ranked(item.known(estimate, views), left, arguments.criterion)
        if policy == "random":
            order = [order[i] for i in rng.permutation(len(order))]
        for best in order:  # a camera that sees next to nothing is passed over
            left = [camera for camera in left if camera is not best.T_world_camera]
            view = item.look(best.T_world_camera, len(views))
            if view is not None:
                break
        else:
            break
        views.append(view)
        before, estimate = estimate, item.estimate(views)
        gains = {
            "expected": best.objects[item.case.id].information,
            "realised": realised(before, estimate),
            "turned_deg": turned(before.state, estimate.state),
        }
        rows.append(row(item, policy, len(views), estimate, **gains))
    return rows


def evenly(item: Subject, begun: Estimate, arguments: Arguments) -> list[dict[str, Any]]:
    """All views at once, for every number of them, as far from each other and from the first one as can be."""
    rows = [row(item, "even", 1, begun)]
    looked: dict[int, ObjectView | None] = {0: item.first}
    left = list(range(len(item.cameras) + 1))
    eyes = np.array([each.translation() for each in (item.first.T_world_camera, *item.cameras)])
    apart = np.linalg.norm(eyes[:, None] - eyes, axis=2)
    for count in range(2, arguments.most + 1):
        views: list[ObjectView] = []
        while len(views) < count <= len(left):  # without cameras that turn out to see next to nothing
            chosen = [left[i] for i in spread_out(apart[np.ix_(left, left)], count)]
            for i in chosen:
                if i not in looked:
                    looked[i] = item.look(item.cameras[i - 1], 99 + i)
            left = [i for i in left if i not in looked or looked[i] is not None]
            views = [view for i in chosen if (view := looked[i]) is not None]
        if len(views) == count:
            rows.append(row(item, "even", count, item.estimate(views)))
    return rows


def run(case: Case, arguments: Arguments, picture: Path | None) -> list[dict[str, Any]]:
    """All policies on one object, from the same first view and the same first estimate."""
    item = subject(case, arguments)
    begun = item.estimate([item.first])
    rows = [row(item, policy, 1, begun) for policy in ("next_best", "random")]
    if picture is not None:
        known = item.known(begun, [item.first])
        views = ranked(known, item.cameras, arguments.criterion)
        sphere_picture(known, known.surface_sigma, views, UP, picture, criterion=arguments.criterion)
    for policy in ("next_best", "random"):
        rows += one_by_one(item, policy, begun, arguments)
    return rows + evenly(item, begun, arguments)


def attempt(
    case: Case, arguments: Arguments, picture: Path | None
) -> list[dict[str, Any]] | ObjectGraphError:
    """`run`, whose failure is its result."""
    try:
        return run(case, arguments, picture)
    except ObjectGraphError as error:
        return error


def compared(rows: Sequence[Row], measure: str, ending: str) -> dict[str, Any]:
    """Views that the other policies need for the policy's mean error, by one measure."""
    needed = views_needed(rows, POLICIES[0], GOAL, POLICIES[1:], measure)
    intervals = bootstrap(rows, POLICIES[0], GOAL, POLICIES[1:], measure)
    return {
        **{f"views_{policy}{ending}": count for policy, (count, _) in needed.items()},
        f"reached{ending}": {policy: reached for policy, (_, reached) in needed.items()},
        f"interval{ending}": intervals,
    }


def curves(rows: Sequence[Row]) -> dict[str, dict[str, dict[int, float]]]:
    names = ("chamfer_m", "box_m", "translation_m", "rotation_deg", "scale_pct_max")
    return {name: {policy: mean_errors(rows, policy, name) for policy in POLICIES} for name in names}


def correlation(taken: Sequence[Row]) -> float | None:
    """Of expected and realised information."""
    if len(taken) < 2:
        return None
    return float(np.corrcoef([[r["expected"], r["realised"]] for r in taken], rowvar=False)[0, 1])


def summary(tried: Sequence[Row], failed: int, arguments: Arguments) -> dict[str, Any]:
    """Figures of the objects that every policy saw as often as it was to; how many it did not, and how many failed."""
    most = {policy: GOAL if policy == POLICIES[0] else arguments.most for policy in POLICIES}
    rows = seen_by_all(tried, most)
    if not rows:
        raise SystemExit(
            "no object was seen as often as every policy was to see it: give more --candidates or less --most"
        )
    right = within(rows, "rotation_deg", RIGHT_MODE_DEG)
    taken = [r for r in rows if "expected" in r]
    return {
        "objects": len(objects_of(rows)),
        "objects_left_out": len(objects_of(tried)) - len(objects_of(rows)),
        "objects_failed": failed,
        "objects_right": len(objects_of(right)),
        "views_next_best": GOAL,
        **compared(rows, "chamfer_m", ""),
        **compared(rows, "box_m", "_box"),
        **compared(right, "box_m", "_box_right"),
        "gain_correlation": correlation(taken),
        "gain_correlation_same_mode": correlation([r for r in taken if r["turned_deg"] <= RIGHT_MODE_DEG]),
        "curves": curves(rows),
        "curves_right": curves(right),
        "settings": settings(arguments),
    }


def settings(arguments: Arguments) -> dict[str, str]:
    """What the rows depend on."""
    return {k: str(v) for k, v in vars(arguments).items() if k not in ("out", "objects", "jobs")}


def draw(metrics: dict[str, Any], path: Path) -> None:
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
    count, right = metrics["objects"], metrics["objects_right"]
    panels = (
        ("curves", "chamfer_m", "Chamfer", f"{count} object{'s' * (count > 1)}"),
        ("curves", "box_m", "error of box corners", f"{count} object{'s' * (count > 1)}"),
        ("curves_right", "box_m", "error of box corners", f"the {right} never in a wrong heading"),
    )
    for axis, (over, name, label, which) in zip(axes, panels, strict=True):
        for policy in POLICIES:
            found = metrics[over][name][policy]
            errors = [100 * error for error in found.values()]
            axis.plot([int(n) for n in found], errors, "o-", label=policy.replace("_", " "))
        axis.set(xlabel="views", ylabel=f"mean {label} (cm)", title=which)
        axis.xaxis.get_major_locator().set_params(integer=True)
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
    axes[0].legend()
    figure.savefig(path)


def main(arguments: Arguments) -> None:
    arguments.out.mkdir(parents=True, exist_ok=True)
    store = arguments.out / "rows.json"
    kept = json.loads(store.read_text()) if store.exists() else {"settings": settings(arguments), "rows": []}
    if kept["settings"] != settings(arguments):
        raise SystemExit(f"{store} is of other settings: choose another --out")
    each = -(-arguments.objects // 2)
    cases = [
        case
        for pair in zip(
            *(
                synthetic_cases(
                    BenchmarkConfig(
                        seed=arguments.seed,
                        objects=each,
                        categories=(name,),
                        difficulty=arguments.difficulty,
                        shapes=arguments.shapes,
                        meshes=arguments.meshes,
                    )
                )
                for name in ("chair", "table")
            ),
            strict=True,
        )
        for case in pair
    ][: arguments.objects]
    done = {r["object"] for r in kept["rows"]}
    missing = [case for case in cases if case.id not in done]
    pictures = {cases[0].id: arguments.out / "information.png"}
    works = [partial(attempt, case, arguments, pictures.get(case.id)) for case in missing]
    for place, rows in track(spread(works, Workers(arguments.jobs)), "objects", total=len(works)):
        if isinstance(rows, ObjectGraphError):
            print(f"{missing[place].id} is left out: {rows}")
            continue
        kept["rows"] += rows
        write_file(store, (json.dumps(kept) + "\n").encode())
    chosen = [r for r in kept["rows"] if r["object"] in {case.id for case in cases}]
    metrics = summary(chosen, len(cases) - len(objects_of(chosen)), arguments)
    write_file(arguments.out / "metrics.json", (json.dumps(metrics, indent=2) + "\n").encode())
    draw(metrics, arguments.out / "active_vision.png")
    print({k: v for k, v in metrics.items() if k not in ("curves", "curves_right", "settings")})


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
