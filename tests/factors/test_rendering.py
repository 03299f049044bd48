import numpy as np
import pytest
import torch
from scipy.integrate import trapezoid
from scipy.stats import norm

from factors.full_distribution import FullDistribution
from factors.gaussian_depth import Deterministic, Probabilistic, Sampled
from factors.occupancy import probit_occupancy, termination
from factors.rays import RayCells
from factors.rendering import RaySamples, RayTargets
from factors.score import energy_score, unit_information_weight

RENDERERS = [
    FullDistribution(),
    FullDistribution(reach=None),
    Probabilistic(),
    Sampled(),
    Deterministic(),
]


def _scene(rays: int = 5, k: int = 8, seed: int = 0):
    generator = torch.Generator().manual_seed(seed)
    edges = torch.linspace(1, 2, k + 1).double().expand(rays, -1)
    cells = RayCells(0.5 * (edges[:, 1:] + edges[:, :-1]), edges.diff(dim=1), edges[:, -1])
    sdf = 0.2 * torch.randn(rays, k, generator=generator).double()
    sdf_sigma = 0.01 + 0.02 * torch.rand(rays, k, generator=generator).double()
    end = torch.tensor([torch.inf, 1.3, 1.8]).double().repeat(rays)[:rays]
    hit, sigma = torch.arange(rays) % 2 == 0, torch.full((rays,), 0.01).double()
    return sdf, sdf_sigma, cells, RayTargets(torch.full_like(sigma, 1.5), hit, end, sigma)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_rows_have_the_gradient_of_the_loss(renderer):
    sdf, sdf_sigma, cells, targets = _scene()
    spread = renderer.freeze(RaySamples(sdf, sdf_sigma, cells, targets, 60.0))

    def loss(values):
        return renderer.render(RaySamples(values, sdf_sigma, cells, targets, 60.0), spread).loss.sum()

    rendered = renderer.render(RaySamples(sdf, sdf_sigma, cells, targets, 60.0), spread)
    alone = renderer.loss(RaySamples(sdf, sdf_sigma, cells, targets, 60.0), spread)
    torch.testing.assert_close(alone, rendered.loss, rtol=1e-12, atol=1e-15)
    gradient = torch.einsum("rqk,rq->rk", rendered.d_sdf, rendered.residual)
    step = 1e-6
    for i in np.ndindex(*sdf.shape):
        up, down = sdf.clone(), sdf.clone()
        up[i] += step
        down[i] -= step
        numeric = float(loss(up) - loss(down)) / (2 * step)
        assert float(gradient[i]) == pytest.approx(numeric, rel=1e-4, abs=1e-6)
    assert (0.5 * rendered.residual.square().sum(dim=1) <= rendered.loss + 1e-12).all()


@pytest.mark.parametrize("reach", [None, 2.0])
def test_full_distribution_is_the_numerical_weighted_crps(reach):
    renderer = FullDistribution(reach)
    k = 4000
    sdf, _, _, targets = _scene(rays=5, k=6)
    # the same SDF, finely and linearly interpolated: the sum over cells becomes the integral
    fine = torch.nn.functional.interpolate(sdf[:, None], size=k, mode="linear", align_corners=True)[:, 0]
    edges = torch.linspace(1, 2, k + 1).double().expand(5, -1)
    cells = RayCells(0.5 * (edges[:, 1:] + edges[:, :-1]), edges.diff(dim=1), edges[:, -1])
    sigma = torch.full_like(fine, 0.05)
    spread = renderer.freeze(RaySamples(fine, sigma, cells, targets, 200.0))
    loss = renderer.render(RaySamples(fine, sigma, cells, targets, 200.0), spread).loss
    tau = np.sqrt(0.05**2 + 0.01**2 + (1.702 / 200) ** 2)
    clear = norm.cdf(fine.numpy() / tau)
    passed = np.minimum.accumulate(clear, 1)
    # beyond the box, up to 1.1 times its far side, the transmittance stays what it is
    depth = np.concatenate([cells.depth[0].numpy(), np.linspace(2, 2.2, k)])
    passed = np.concatenate([passed, np.repeat(passed[:, -1:], k, axis=1)], axis=1)
    for ray in range(5):
        end, hit = min(float(targets.end[ray]), 2.2), bool(targets.hit[ray])
        weight = (depth < end).astype(float)
        if reach is not None:
            before = min(1.0, tau / (min(1.5 - reach * tau, end) - 1))
            behind = min(1.0, tau / max(end - 1.5 - reach * tau, 1e-12))
            weight *= np.where(np.abs(depth - 1.5) < reach * tau, 1.0, np.where(depth < 1.5, before, behind))
        error = weight * (1 - passed[ray] - (hit & (depth >= 1.5))) ** 2
        assert float(loss[ray]) == pytest.approx(trapezoid(error, depth), rel=5e-3, abs=1e-4)


@pytest.mark.parametrize("reach", [None, 5.0])
def test_the_distribution_of_a_plane_is_gaussian_and_so_is_its_score(reach):
    """A plane across the ray, thick behind: F is Phi((d - surface) / tau), whose score has a closed form."""
    k, tau = 4000, np.sqrt(0.03**2 + 0.01**2 + (1.702 / 400) ** 2)
    edges = torch.linspace(1, 2, k + 1).double()[None]
    cells = RayCells(0.5 * (edges[:, 1:] + edges[:, :-1]), edges.diff(dim=1), edges[:, -1])
    sdf, sigma = 1.45 - cells.depth, torch.full_like(cells.depth, 0.03)
    depth, end, noise = torch.tensor([[1.5], [torch.inf], [0.01]]).double()
    targets = RayTargets(depth, torch.tensor([True]), end, noise)
    renderer = FullDistribution(reach=reach)
    spread = renderer.freeze(RaySamples(sdf, sigma, cells, targets, 400.0))
    assert float(spread) == pytest.approx(tau)
    loss = renderer.render(RaySamples(sdf, sigma, cells, targets, 400.0), spread).loss
    expected = energy_score(torch.tensor(-0.05).double(), torch.tensor(tau).double())
    assert float(loss) == pytest.approx(float(expected), rel=1e-3)


def test_the_rows_of_a_plane_have_1_over_sqrt_2_of_its_score_s_curvature():
    """Squares of Phi' integrate to 1 / (2 sqrt(pi) tau), the score's second derivative at its minimum is 2 phi(0) / tau."""
    k, tau = 4000, np.sqrt(0.03**2 + 0.01**2 + (1.702 / 400) ** 2)
    edges = torch.linspace(1, 2, k + 1).double()[None]
    cells = RayCells(0.5 * (edges[:, 1:] + edges[:, :-1]), edges.diff(dim=1), edges[:, -1])
    depth, end, noise = torch.tensor([[1.5], [torch.inf], [0.01]]).double()
    targets = RayTargets(depth, torch.tensor([True]), end, noise)
    sigma = torch.full_like(cells.depth, 0.03)
    samples = RaySamples(1.5 - cells.depth, sigma, cells, targets, 400.0)
    renderer = FullDistribution(reach=None)
    d_plane = renderer.render(samples, renderer.freeze(samples)).d_sdf.sum(dim=2)
    curvature = float(d_plane.square().sum()) * float(unit_information_weight(torch.tensor(tau)))
    assert curvature == pytest.approx(1 / (np.sqrt(2) * tau**2), rel=1e-3)


def test_comonotone_does_not_depend_on_the_sampling_and_independent_does():
    def behind(k: int) -> tuple[float, float]:
        """A sheet, 1 cm thick: by the smallest share that passes, and by the paper's product."""
        depth = torch.linspace(-0.1, 0.1, k, dtype=torch.float64)[None]
        sdf, tau = depth.abs() - 0.005, torch.full_like(depth, 0.02)
        passed, _ = FullDistribution().transmittance(sdf, tau)
        _, escaped = termination(probit_occupancy(sdf, tau))
        return float(passed[0, -1]), float(escaped)

    (smallest, product), (smallest_fine, product_fine) = behind(41), behind(401)
    assert smallest == pytest.approx(smallest_fine, abs=1e-6)
    assert product_fine < 0.5 * product


@pytest.mark.parametrize("renderer", RENDERERS)
def test_a_free_ray_that_passes_the_object_costs_nothing(renderer):
    sdf, sdf_sigma, cells, targets = _scene()
    targets = RayTargets(targets.depth, torch.zeros(5, dtype=torch.bool), targets.end, targets.sigma)
    far = torch.full_like(sdf, 1.0)
    spread = renderer.freeze(RaySamples(far, sdf_sigma, cells, targets, 400.0))
    loss = renderer.render(RaySamples(far, sdf_sigma, cells, targets, 400.0), spread).loss
    assert float(loss.max()) < 0.24 * float(spread.max())


def test_both_sides_of_an_outline_weigh_the_same():
    """Half the rays hit a sharp edge, half pass it: the score of an edge moved by x is that of one moved by -x."""
    across = torch.linspace(-0.1, 0.1, 201).double()
    edges = torch.linspace(1, 2, 401).double().expand(201, -1)
    cells = RayCells(0.5 * (edges[:, 1:] + edges[:, :-1]), edges.diff(dim=1), edges[:, -1])
    depth = torch.full_like(across, 1.4)
    targets = RayTargets(depth, across < 0, torch.full_like(depth, 1.9), torch.full_like(depth, 0.01))
    renderer, sigma = FullDistribution(), torch.full_like(cells.depth, 0.02)

    def loss(shift):
        """A thick half-space whose front is at 1.4 and whose outline lies at `shift`."""
        front, side = 1.4 - cells.depth, (across - shift)[:, None].expand_as(cells.depth)
        sdf = torch.maximum(front, side)
        spread = renderer.freeze(RaySamples(sdf, sigma, cells, targets, 400.0))
        return float(renderer.render(RaySamples(sdf, sigma, cells, targets, 400.0), spread).loss.sum())

    assert loss(0.0) < min(loss(0.01), loss(-0.01))
    assert loss(0.01) == pytest.approx(loss(-0.01), rel=0.1)
