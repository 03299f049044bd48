"""What is wrong with a scan: each fault against what it says, drawn alike every time, varied within a set."""

import contextlib
import dataclasses

import numpy as np
import open3d as o3d
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from objgraph.bench.worlds.cases import BenchmarkConfig, Case, synthetic_cases
from objgraph.bench.worlds.crowd import pushed_against
from objgraph.bench.worlds.families import FAMILIES, make_piece
from objgraph.datasets.ground_truth import AnnotatedScan
from objgraph.errors import DatasetError
from objgraph.synthetic.faults import EVERYDAY, HARD, FaultRanges, Faults, faults_from, ranges_of
from objgraph.synthetic.faulty_images import faulty_depth, faulty_masks
from objgraph.synthetic.photograph import MEASURED, dark_places
from objgraph.synthetic.scene import stand
from objgraph.synthetic.sensor import SensorConfig, sense_masks
from tests.conftest import REPOSITORY

NONE = Faults(
    0.3, 2.0, 0.0, False, 0.0, 10.0, False, 0.2, mask_border_px=0.0, mask_thin_px=0.0, mask_part=0.0, merged=False,
    sensor=1.0, flying=0.0, holes=0.0, fusion_px=0.0, camera_m=0.0, camera_deg=0.0, floor_m=0.0,
)  # fmt: skip
PERFECT = SensorConfig(0, 0, 0, 0, 0, (2, 3), 0, (0, 10), 0)
SEED = 2000


def scene(width: int = 320) -> np.ndarray:
    """A square target with a leg, a neighbour that touches it, another apart."""
    masks = np.zeros((240, width), dtype=int)
    masks[60:120, 60:120] = 1
    masks[120:180, 85:88] = 1
    masks[60:120, 120:180] = 2
    masks[200:230, 250:300] = 3
    return masks


def masked(seed: int = 0, **strengths) -> np.ndarray:
    return faulty_masks(scene(), 1, dataclasses.replace(NONE, **strengths), np.random.default_rng(seed))


def test_no_fault_changes_nothing():
    np.testing.assert_array_equal(masked(), scene())
    depth = np.full((240, 320), 2.0)
    seen = faulty_depth(depth, 0 * depth, depth < 0, NONE, PERFECT, np.random.default_rng(0))
    np.testing.assert_array_equal(seen, depth)


def test_thin_parts_are_missing_and_thick_ones_stay():
    masks = masked(mask_thin_px=8.0)  # four pixels here, and the leg has three
    assert not (masks[125:180] == 1).any()
    assert (masks[60:120, 60:120] == 1).mean() > 0.97
    assert (masked(mask_thin_px=2.0)[125:175, 86] == 1).all()


@pytest.mark.parametrize("width", [1.0, 1.9, 2.1, 3.0, 3.9, 4.1, 5.9, 6.1, 8.0, 8.1])
def test_what_is_thinner_than_asked_is_missing_and_nothing_else(width):
    """Bars of 1 to 4 pixels, upright and level, which are 2 to 8 of an image 640 wide; also at the picture's border."""
    masks = np.zeros((240, 320), dtype=int)
    for pixels_wide in (1, 2, 3, 4):
        masks[40:200, 30 * pixels_wide : 31 * pixels_wide] = pixels_wide
        masks[30 * pixels_wide : 31 * pixels_wide, 200:] = 4 + pixels_wide
    faults = dataclasses.replace(NONE, mask_thin_px=width)
    seen = faulty_masks(masks, 1, faults, np.random.default_rng(0))
    for pixels_wide in (1, 2, 3, 4):
        stays = 2 * pixels_wide >= width
        for bar in (pixels_wide, 4 + pixels_wide):
            assert (seen == bar).sum() >= 0.97 * stays * (masks == bar).sum()
            assert stays or not (seen == bar).any()
        # where the picture ends no bar does
        assert (seen[30 * pixels_wide : 31 * pixels_wide, -1] == 4 + pixels_wide).all() == stays


def test_two_that_touch_become_one_mask():
    masks = masked(merged=True)
    assert (masks[60:120, 60:180] == 1).all()
    assert (masks == 3).sum() == (scene() == 3).sum()
    alone = scene()
    alone[alone == 2] = 0
    seen = faulty_masks(alone, 1, dataclasses.replace(NONE, merged=True), np.random.default_rng(0))
    np.testing.assert_array_equal(seen, alone)


@given(st.integers(0, 10**6), st.floats(0.05, 0.3))
def test_a_part_is_missing_or_taken_and_as_large_as_it_says(seed, share):
    before, after = scene() == 1, masked(seed, mask_part=share) == 1
    lost, won = (before & ~after).sum(), (after & ~before).sum()
    assert min(lost, won) == 0
    assert lost + won == int(share * before.sum())
    changed = before ^ after
    v, u = np.nonzero(changed)
    # next to one place, not here and there
    assert max(np.ptp(v), np.ptp(u)) < 6 * np.sqrt(max(len(v), 1)) + 1


@pytest.mark.parametrize("strength", [2.0, 8.0])
def test_borders_are_as_wrong_as_they_say(strength):
    """Displaced by so many pixels of an image 640 wide, root mean square over rows and columns."""
    depth_of = ndimage.distance_transform_edt
    block = np.zeros((240, 320), dtype=int)
    block[40:200, 60:260] = 1
    faults = dataclasses.replace(NONE, mask_border_px=strength)
    off = []
    for seed in range(12):
        wrong = faulty_masks(block, 1, faults, np.random.default_rng(seed)) != block
        away = np.asarray(depth_of(block == 1)) + np.asarray(depth_of(block == 0))
        # along the lower edge, how far in or out the border lies
        off += [away[190:, column][wrong[190:, column]].max(initial=0) for column in range(80, 240)]
    # one axis of the displacement
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(strength / 2 / np.sqrt(2), rel=0.3, abs=0.3)


@pytest.mark.parametrize(("strength", "moved"), [(None, 1.1), (2.0, 1.5), (4.0, 2.8), (8.0, 5.6)])
def test_an_upright_border_moves_as_the_documentation_says(strength, moved):
    """In pixels of an image 640 wide, of which one here is two; None is the clean scan."""
    half = np.zeros((240, 320), dtype=int)
    half[:, 160:] = 1
    off = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        seen = (
            sense_masks(half, SensorConfig(), rng)
            if strength is None
            else faulty_masks(half, 1, dataclasses.replace(NONE, mask_border_px=strength), rng)
        )
        off.append(2.0 * (seen.argmax(axis=1) - 160))
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(moved, rel=0.05)
    page = (REPOSITORY / "docs" / "reference" / "benchmark.md").read_text()
    assert "move by 1.1 pixels" in page
    assert "1.5 and 2.8 pixels at 2 and 4, 5.6 at 8" in page


def test_flying_pixels_lie_between_and_dark_ones_have_no_depth():
    depth = np.full((240, 320), 2.0)
    depth[:, 160:] = 3.0
    dark = np.zeros(depth.shape, dtype=bool)
    dark[:20, :20] = True
    faults = dataclasses.replace(NONE, flying=1.0)
    config = dataclasses.replace(PERFECT, edge_jump_m=0.05)
    seen = faulty_depth(depth, 0 * depth, dark, faults, config, np.random.default_rng(0))
    assert not seen[dark].any()
    edge = seen[30:, 159:161]
    assert ((edge > 2.0) & (edge < 3.0)).mean() > 0.95
    assert (seen[30:, :158] == 2.0).all()
    assert (seen[30:, 162:] == 3.0).all()


@pytest.mark.parametrize("strength", [1.0, 2.0])
def test_as_many_pixels_fly_as_asked_and_none_away_from_edges(strength):
    """With the sensor that scans have: neither its noise nor the edges that it loses are taken for edges or hide them."""
    depth = np.full((240, 320), 3.0)
    depth[60:180, 100:220] = 2.2
    depth[:, 300:] = 0.0
    still = dataclasses.replace(NONE, sensor=strength)
    a, b = (
        faulty_depth(depth, 0 * depth, depth < 0, faults, SensorConfig(), np.random.default_rng(3))
        for faults in (dataclasses.replace(still, flying=0.4), still)
    )
    edge = ndimage.maximum_filter(depth[:, :299], 3) - ndimage.minimum_filter(depth[:, :299], 3) > 0.5
    edge = np.pad(edge, ((0, 0), (0, 21)))
    flying = a != b
    assert flying[edge & (b > 0)].mean() == pytest.approx(0.4, abs=0.05)
    assert not flying[~edge].any()
    assert not a[b == 0].any()
    assert ((a[flying] >= 2.2) & (a[flying] <= 3.0)).all()


@given(st.integers(0, 10**6), st.floats(0.0, 0.3))
def test_dark_places_cover_the_share_that_is_asked_of_what_is_seen(seed, share):
    """Of a box of 30 cm, of which a spot of 10 cm radius is one part in twelve, with as large a surface hidden within."""
    outer = trimesh.creation.box([0.3, 0.3, 0.5])
    inner = trimesh.creation.box([0.28, 0.28, 0.48])
    rng = np.random.default_rng(seed)
    surface = np.concatenate([outer.triangles, inner.triangles])
    dark = dark_places(np.asarray(surface), share, rng)
    points = np.asarray(trimesh.sample.sample_surface(outer, 4000, seed=1)[0])
    assert dark.hide(points).mean() == pytest.approx(share, abs=0.05)
    # every spot is on what is seen
    assert (np.abs(np.abs(dark.p_world) / [0.15, 0.15, 0.25]).max(axis=1, initial=0) > 0.999).all()
    assert ((dark.radius > 0) & (dark.radius <= 0.1)).all()
    assert (dark.radius[:-1] == 0.1).all()


def test_the_mean_share_of_dark_places_is_the_drawn_one():
    box = trimesh.creation.box([0.3, 0.3, 0.5])
    points = np.asarray(trimesh.sample.sample_surface(box, 2000, seed=1)[0])
    rng = np.random.default_rng(0)
    over = []
    for _ in range(60):
        share = rng.uniform(0.0, 0.15)
        over.append(dark_places(np.asarray(box.triangles), share, rng).hide(points).mean() - share)
    assert np.mean(over) == pytest.approx(0, abs=0.005)


def test_fusion_smooths_surfaces_and_keeps_steps():
    rng = np.random.default_rng(0)
    depth = 2.0 + 0.01 * rng.normal(size=(120, 160))
    depth[:, 80:] += 1.0
    faults = dataclasses.replace(NONE, fusion_px=8.0)
    seen = faulty_depth(depth, 0 * depth, depth < 0, faults, PERFECT, rng)
    assert seen[20:100, 20:60].std() < 0.006
    assert seen[:, 79].max() < 2.1
    assert seen[:, 80].min() > 2.9


def test_strengths_are_within_their_ranges_and_all_over_them():
    for ranges in (EVERYDAY, HARD):
        drawn = [ranges.draw(np.random.default_rng(i)) for i in range(400)]
        for field in dataclasses.fields(FaultRanges):
            bounds, values = getattr(ranges, field.name), [getattr(each, field.name) for each in drawn]
            if isinstance(bounds, tuple):
                assert bounds[0] <= min(values) <= max(values) <= bounds[1]
                assert np.ptp(values) > 0.9 * (bounds[1] - bounds[0])
            else:
                assert np.mean(values) == pytest.approx(bounds, abs=0.08)


def test_hard_is_harder():
    """No range of `hard` begins or ends on the easy side of that of `everyday`; near and much of the object is easy."""
    for field in dataclasses.fields(FaultRanges):
        easy, hard = (np.atleast_1d(getattr(ranges, field.name)) for ranges in (EVERYDAY, HARD))
        if field.name in ("visible", "apart_deg", "walk_m"):
            easy, hard = -easy, -hard
        assert (np.abs(hard).max() if field.name == "floor_m" else hard.max()) >= easy.max(), field.name
        assert hard.mean() >= easy.mean() - 1e-12, field.name


def test_ranges_come_from_json():
    assert faults_from({"visible": [0.1, 0.2], "merged": 1}, "hard") == dataclasses.replace(
        HARD, visible=(0.1, 0.2), merged=1
    )
    with pytest.raises(DatasetError, match="'vissible' is none"):
        faults_from({"vissible": [0, 1]}, "hard")
    with pytest.raises(DatasetError, match="visible: two numbers"):
        faults_from({"visible": 0.5}, "hard")
    with pytest.raises(DatasetError, match="clean"):
        faults_from({}, "clean")
    with pytest.raises(DatasetError, match="no difficulty 'easy'"):
        ranges_of("easy")


@given(st.recursive(st.none() | st.booleans() | st.floats() | st.text(max_size=9), lambda x: st.lists(x) | st.dictionaries(st.sampled_from([f.name for f in dataclasses.fields(FaultRanges)]) | st.text(max_size=3), x)))  # fmt: skip
def test_any_other_json_is_refused(values):
    with contextlib.suppress(DatasetError):
        assert isinstance(faults_from(values, "hard"), FaultRanges)


@pytest.fixture(scope="module")
def seen() -> list[tuple[Case, AnnotatedScan]]:
    cases = synthetic_cases(BenchmarkConfig(seed=SEED, objects=3, difficulty="hard"))
    return [(case, case.scan()) for case in cases]


def test_a_scan_says_what_is_wrong_with_it(seen):
    for case, scan in seen:
        faults, found = case.faults, scan.conditions
        assert faults is not None
        assert found["visible"] == sorted(found["visible"])
        assert abs(found["visible"][-1] - faults.visible) < 0.1
        assert all(len(found[name]) == 3 for name in MEASURED)
        assert all(0.5 <= off / faults.camera_m <= 1 for off in found["camera_error_m"])
        assert all(0.5 <= off / faults.camera_deg <= 1 for off in found["camera_error_deg"])
        assert all(0 <= share <= 1 for name in MEASURED[:3] for share in found[name])
        assert {field.name for field in dataclasses.fields(Faults)} <= set(found)
    # masks and depth are wrong, and not alike in a set
    recall = np.array([scan.conditions["mask_recall"] for _, scan in seen])
    assert (recall < 0.97).any()
    assert recall.mean(axis=1).std() > 0.02


def test_a_merged_objects_row_says_that_a_piece_is_pushed_against_it(seen):
    case, _ = seen[0]
    assert case.faults is not None
    merged = dataclasses.replace(case, faults=dataclasses.replace(case.faults, pushed=False, merged=True))
    apart = dataclasses.replace(case, faults=dataclasses.replace(case.faults, pushed=False, merged=False))
    assert merged.scan().conditions["pushed"] is True
    assert apart.scan().conditions["pushed"] is False


def test_cameras_are_told_wrong_by_what_the_scan_says(seen):
    """The same case with cameras told right has the same pictures, and poses that differ by as much."""
    case, scan = seen[0]
    assert case.faults is not None
    right = dataclasses.replace(
        case, faults=dataclasses.replace(case.faults, camera_m=0.0, camera_deg=0.0)
    ).scan()
    for k in range(3):
        told, true = scan.frames[k].T_world_camera, right.frames[k].T_world_camera
        np.testing.assert_array_equal(scan.frames[k].depth, right.frames[k].depth)
        assert np.linalg.norm(told[:3, 3] - true[:3, 3]) == pytest.approx(
            scan.conditions["camera_error_m"][k], rel=1e-3
        )
        cosine = (np.trace(told[:3, :3].T @ true[:3, :3]) - 1) / 2
        assert np.degrees(np.arccos(cosine)) == pytest.approx(
            scan.conditions["camera_error_deg"][k], rel=1e-3
        )


def test_equal_cases_have_equal_faults_and_other_sets_have_the_same_strengths(seen):
    case, scan = seen[1]
    again = case.scan()
    assert again.conditions == scan.conditions
    for k in range(3):
        np.testing.assert_array_equal(again.frames[k].depth, scan.frames[k].depth)
        np.testing.assert_array_equal(again.frames[k].instances, scan.frames[k].instances)
    hard, everyday = (
        synthetic_cases(BenchmarkConfig(seed=SEED, objects=9, difficulty=each))[4:6]
        for each in ("hard", "everyday")
    )
    assert all(a.id != b.id and a.shape == b.shape for a, b in zip(hard, everyday, strict=True))


def test_spacing_is_for_clean_scans():
    with pytest.raises(DatasetError, match="spacing"):
        synthetic_cases(BenchmarkConfig(difficulty="hard", spacing="close"))


@settings(max_examples=5)
@given(st.integers(0, 10**6))
def test_neighbours_are_pushed_together_and_do_not_intersect(seed):
    rng = np.random.default_rng(seed)
    chair, table = (make_piece(c, str(rng.choice(FAMILIES[c])), rng) for c in ("chair", "table"))
    target = stand(chair, np.full(3, chair.diagonal_m), np.zeros(2), rng.uniform(-3, 3))
    other = pushed_against(target, table, rng)
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        np.array(target.p_world, np.float32, subok=False), np.asarray(chair.mesh.faces, np.uint32)
    )
    mesh = trimesh.Trimesh(other.p_world, table.mesh.faces, process=False)
    points = np.asarray(trimesh.sample.sample_surface(mesh, 4000, seed=1)[0])
    gap = scene.compute_distance(points.astype(np.float32)).numpy().min()
    assert 0.0 < gap < 0.15


def test_the_documentation_has_these_ranges():
    page = (REPOSITORY / "docs" / "reference" / "benchmark.md").read_text()
    rows = {
        cells[1].strip("` "): cells[2:4] for line in page.splitlines() if len(cells := line.split("|")) == 6
    }

    def words(value) -> str:
        return f"{value[0]:g} to {value[1]:g}" if isinstance(value, tuple) else f"{value:g}"

    for field in dataclasses.fields(FaultRanges):
        told = [cell.strip() for cell in rows[field.name]]
        assert told == [words(getattr(ranges, field.name)) for ranges in (EVERYDAY, HARD)], field.name
