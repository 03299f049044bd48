"""Objects inside a GTSAM graph that the caller owns."""

from dataclasses import dataclass, field
from typing import Literal

import gtsam
import numpy as np
from jaxtyping import Float

from factors.base import Annealing, ObservationFactor
from factors.depth import DepthFactor, RaySampling
from factors.full_distribution import FullDistribution
from factors.gaussian_depth import Deterministic, Probabilistic, Sampled
from factors.priors import code_prior, scale_prior, upright_prior
from factors.rays import Rays
from factors.rendering import Renderer
from factors.state import ObjectKeys, ObjectState
from factors.surface import SurfaceFactor
from factors.weighting import Weighting
from objgraph.covariance import ObjectCovariance, marginals
from objgraph.errors import SolveError
from objgraph.prior.prior import ShapePrior
from objgraph.sampling import ObjectView
from objgraph.solve import Problem, SolverConfig, solve

RENDERERS: dict[str, Renderer] = {
    "full": FullDistribution(),
    "probabilistic": Probabilistic(),
    "sampled": Sampled(),
    "deterministic": Deterministic(),
}


@dataclass(frozen=True)
class GraphConfig:
    """How measurements and priors are weighed."""

    renderer: Literal["full", "probabilistic", "sampled", "deterministic"] = "full"
    """The 2D factor's renderer: the full termination distribution, or a Gaussian depth, the paper's, NodeSLAM's or
    DSP-SLAM's."""
    sampling: RaySampling = field(default_factory=RaySampling)
    evidence: float = 1.0
    """Independent measurements a patch of seen surface counts for, in each of the two factors of a view."""
    anisotropy_sigma: float = 0.1
    """Standard deviation of each axis' log-scale about their mean: the code, not the scale, stretches shapes."""
    code_spread: float = 3.0
    """Factor on the code prior's standard deviations: a Gaussian through several kinds of shapes is dense between
    them, at shapes of no kind (a table without legs), and would hold codes there."""
    upright_sigma: float = 0.03
    """Radians by which an object that stands on the floor may lean, about each level axis."""


@dataclass
class ObjectHandle:
    """One object of an `ObjectGraph`."""

    name: str
    keys: ObjectKeys
    prior: ShapePrior
    factors: list[ObservationFactor] = field(default_factory=list)
    views: list[str] = field(default_factory=list)


class ObjectGraph:
    """Adds objects, their priors and their views to the caller's graph and values; owns neither."""

    def __init__(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        config: GraphConfig | None = None,
    ) -> None:
        self.graph = graph
        self.values = values
        self.config = config or GraphConfig()
        self.objects: list[ObjectHandle] = []

    def add_object(
        self,
        prior: ShapePrior,
        state: ObjectState,
        *,
        up_world: Float[np.ndarray, "3"] | None = None,
        keys: ObjectKeys | None = None,
        name: str | None = None,
    ) -> ObjectHandle:
        """Add an object's variables at `state` and the priors on its code, its scale and, with `up_world`, its lean.

        Raises:
            FactorError: one of the keys is already in the values.
        """
        keys = keys or ObjectKeys.numbered(self._free_index())
        state.insert(self.values, keys)
        spread = self.config.code_spread**2
        self.graph.push_back(code_prior(keys, prior.code_mean, spread * prior.code_covariance))
        anisotropy = prior.anisotropy_sigma or self.config.anisotropy_sigma
        self.graph.push_back(scale_prior(keys, np.log(prior.size_mean), prior.size_log_sigma, anisotropy))
        if up_world is not None:
            self.graph.push_back(upright_prior(keys, up_world, self.config.upright_sigma))
        handle = ObjectHandle(name or f"{prior.category} {len(self.objects)}", keys, prior)
        self.objects.append(handle)
        return handle

    def observe(
        self, handle: ObjectHandle, view: ObjectView, camera: gtsam.Pose3 | int | None = None
    ) -> None:
        """Add the 3D and the 2D factor of one view.

        `camera` is T_world_camera, or the key of a `Pose3` that holds it; by default the view's own pose.
        """
        camera = view.T_world_camera if camera is None else camera
        prior = handle.prior
        surface = SurfaceFactor(
            handle.keys, prior.decoder, camera, view.points_camera, view.points_sigma,
            prior_sigma=prior.residual_sigma, weighting=self._weighting(view.points_share),
        )  # fmt: skip
        self._add(handle, surface)
        self._add(handle, self._depth_factor(handle, camera, view.rays, view.rays_share))
        handle.views.append(view.frame)

    def add_free_rays(self, handle: ObjectHandle, camera: gtsam.Pose3 | int, rays: Rays) -> None:
        """Add a 2D factor alone, of rays each of which is one independent measurement."""
        self._add(handle, self._depth_factor(handle, camera, rays, np.ones(len(rays.depth))))

    def refresh(self, annealing: Annealing = Annealing()) -> None:  # noqa: B008
        """Freeze noise and ray samples at the current values; the caller's optimiser may then run."""
        for handle in self.objects:
            for factor in handle.factors:
                factor.refresh(self.values, annealing)

    def optimize(self, config: SolverConfig | None = None) -> list[Problem]:
        """Minimise the whole graph, each connected part by itself; the values are updated in place.

        Raises:
            SolveError: a part failed; the message names its objects. Parts that succeeded are updated all the same.
        """
        problems = self.problems()
        solve(problems, config)
        for problem in problems:
            self.values.update(problem.values)
        failed = [f"{problem.name}: {problem.failure}" for problem in problems if problem.failure]
        if failed:
            raise SolveError("; ".join(failed))
        return problems

    def problems(self) -> list[Problem]:
        """The graph's connected parts, each with the values and the decoder factors that belong to it.

        Raises:
            SolveError: a factor's variable is not in the values.
        """
        part = _Parts()
        for key in self.graph.keyVector():
            if not self.values.exists(key):
                raise SolveError(
                    f"the graph has factors on {gtsam.DefaultKeyFormatter(key)}, which is not in the values: "
                    "insert a first estimate of it"
                )
        indices = [i for i in range(self.graph.size()) if self.graph.exists(i)]
        for i in indices:
            part.join(self.graph.at(i).keys())
        for handle in self.objects:
            part.join(list(handle.keys))
        graphs: dict[int, gtsam.NonlinearFactorGraph] = {}
        for i in indices:
            factor = self.graph.at(i)
            graphs.setdefault(part.of(factor.keys()[0]), gtsam.NonlinearFactorGraph()).push_back(factor)
        problems = []
        for root, graph in graphs.items():
            handles = [handle for handle in self.objects if part.of(handle.keys.pose) == root]
            values = self.values.extract(graph.keyVector())
            name = ", ".join(handle.name for handle in handles) or "variables without objects"
            problems.append(Problem(name, graph, values, [f for h in handles for f in h.factors]))
        return problems

    def state(self, handle: ObjectHandle) -> ObjectState:
        return ObjectState.from_values(self.values, handle.keys)

    def marginals(self, handle: ObjectHandle) -> ObjectCovariance:
        """The object's joint covariance of pose, log-scale and code; raises SolveError where undetermined."""
        for problem in self.problems():
            if any(problem.values.exists(key) for key in handle.keys):
                return marginals(problem.graph, problem.values, handle.keys)
        raise SolveError(f"{handle.name} is not in the graph")

    def _depth_factor(
        self, handle: ObjectHandle, camera: gtsam.Pose3 | int, rays: Rays, share: Float[np.ndarray, "r"]
    ) -> DepthFactor:
        return DepthFactor(
            handle.keys, handle.prior.decoder, camera, rays,
            renderer=self._renderer(), prior_sigma=handle.prior.residual_sigma,
            sampling=self.config.sampling, weighting=self._weighting(share),
        )  # fmt: skip

    def _add(self, handle: ObjectHandle, factor: ObservationFactor) -> None:
        self.graph.push_back(factor.gtsam_factor())
        handle.factors.append(factor)

    def _weighting(self, share: Float[np.ndarray, "n"]) -> Weighting:
        return Weighting("information", np.minimum(1.0, self.config.evidence * share))

    def _renderer(self) -> Renderer:
        return RENDERERS[self.config.renderer]

    def _free_index(self) -> int:
        index = len(self.objects)
        while any(self.values.exists(key) for key in ObjectKeys.numbered(index)):
            index += 1
        return index


class _Parts:
    """Union-find over keys."""

    def __init__(self) -> None:
        self._parent: dict[int, int] = {}

    def of(self, key: int) -> int:
        parent = self._parent.setdefault(key, key)
        if parent != key:
            parent = self._parent[key] = self.of(parent)
        return parent

    def join(self, keys) -> None:
        for key in keys:
            self._parent[self.of(key)] = self.of(keys[0])
