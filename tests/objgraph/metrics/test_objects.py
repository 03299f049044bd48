"""Shape metrics and the whole evaluation of one object."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from objgraph.datasets.ground_truth import GroundTruth
from objgraph.errors import EvaluationError
from objgraph.metrics.objects import Evaluation, evaluate_object
from objgraph.metrics.placed import PlacedMesh
from objgraph.metrics.shape import seen_points_on, surface_errors, volume_iou

BOX = trimesh.creation.box((0.5, 0.6, 0.62))
BALL = trimesh.creation.icosphere(subdivisions=3, radius=0.29)


def rigid(rotvec=(0.0, 0.0, 0.0), translation=(0.0, 0.0, 0.0)):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rotvec).as_matrix()
    T[:3, 3] = translation
    return T


def placed(mesh=BOX, T=None, scale=(1.0, 1.0, 1.0)):
    T = np.eye(4) if T is None else T
    return PlacedMesh("a mesh", T, np.array(scale), np.asarray(mesh.vertices), np.asarray(mesh.faces))


def truth_of(mesh, T=None, scale=(1.0, 1.0, 1.0), symmetry=1):
    T = np.eye(4) if T is None else T
    return GroundTruth(T, np.array(scale), np.asarray(mesh.vertices), np.asarray(mesh.faces), symmetry)


def evaluate(mesh, T, scale, truth) -> Evaluation:
    return evaluate_object(T, np.array(scale), np.asarray(mesh.vertices), np.asarray(mesh.faces), truth)


def table(size=(0.7, 0.4, 0.6)):
    """A top on four legs: closed parts that overlap."""
    x, y, z = np.array(size) / 2
    parts = [trimesh.creation.box(bounds=[[-x, y - 0.03, -z], [x, y, z]])]
    for sx in (-1, 1):
        for sz in (-1, 1):
            corner = np.array([[sx * x, -y, sz * z], [sx * (x - 0.05), y - 0.01, sz * (z - 0.05)]])
            parts.append(trimesh.creation.box(bounds=[corner.min(axis=0), corner.max(axis=0)]))
    return trimesh.util.concatenate(parts)


@pytest.mark.parametrize("mesh", [BOX, BALL, table()], ids=["box", "ball", "table"])
def test_an_object_with_itself_is_perfect(mesh):
    T, scale = rigid((0.3, -1.2, 0.4), (3.0, -1.0, 0.5)), (1.2, 0.9, 1.4)
    result = evaluate(mesh, T, scale, truth_of(mesh, T, scale))
    assert result.pose_correct
    assert result.iou_correct
    assert result.chamfer_correct
    assert (result.translation_m, result.scale_pct, result.scale_pct_max) == pytest.approx(
        (0, 0, 0), abs=1e-9
    )
    assert result.rotation_deg == pytest.approx(0, abs=1e-5)
    assert (result.box_iou, result.volume_iou) == pytest.approx((1, 1), abs=1e-6)
    assert 0 < result.chamfer_m < 0.012  # two independent samples of one surface


def test_thresholds_decide_each_by_itself():
    truth = truth_of(BOX)

    def correct(T=None, scale=(1.0, 1.0, 1.0)):
        return evaluate(BOX, np.eye(4) if T is None else T, scale, truth).pose_correct

    assert correct(rigid(translation=(0.19, 0, 0)))
    assert not correct(rigid(translation=(0.21, 0, 0)))
    assert correct(rigid((0, np.deg2rad(19), 0)))
    assert not correct(rigid((0, np.deg2rad(21), 0)))
    assert correct(scale=(1.19, 1.19, 1.19))
    assert not correct(scale=(1.21, 1.21, 1.21))
    far = evaluate(BOX, rigid(translation=(2.0, 0, 0)), (1, 1, 1), truth)
    assert not far.iou_correct
    assert not far.chamfer_correct
    assert (far.box_iou, far.volume_iou) == (0, 0)


@pytest.mark.parametrize(("symmetry", "degrees"), [(2, 180), (4, 90), (4, 270)])
def test_a_symmetric_table_turned_into_itself_is_perfect(symmetry, degrees):
    mesh = table((0.6, 0.4, 0.6) if symmetry == 4 else (0.7, 0.4, 0.5))
    turned = rigid((0, np.deg2rad(degrees), 0))
    result = evaluate(mesh, turned, (1, 1, 1), truth_of(mesh, symmetry=symmetry))
    assert result.pose_correct
    assert result.rotation_deg == pytest.approx(0, abs=1e-5)
    assert result.box_iou == pytest.approx(1, abs=1e-6)
    assert result.volume_iou > 0.97
    assert not evaluate(mesh, turned, (1, 1, 1), truth_of(mesh)).pose_correct


def test_shifted_boxes_have_the_volume_of_the_closed_form():
    shift = 0.1
    expected = (0.5 - shift) / (0.5 + shift)
    estimate = placed(T=rigid(translation=(shift, 0, 0)))
    assert volume_iou(estimate, placed()) == pytest.approx(expected, abs=0.02)


def test_concentric_balls_have_the_volume_of_the_closed_form():
    assert volume_iou(placed(BALL, scale=(0.8,) * 3), placed(BALL)) == pytest.approx(0.8**3, abs=0.03)


def test_a_ball_in_a_box_of_its_size_fills_the_known_share():
    cube = trimesh.creation.box((0.58, 0.58, 0.58))
    assert volume_iou(placed(BALL), placed(cube)) == pytest.approx(np.pi / 6, abs=0.03)


def test_solids_do_not_depend_on_orientation_overlap_or_seams():
    inverted = BALL.copy()
    inverted.invert()
    soup = trimesh.Trimesh(BALL.triangles.reshape(-1, 3), np.arange(3 * len(BALL.faces)).reshape(-1, 3))
    doubled = BALL + BALL
    for mesh in (inverted, soup, doubled):
        assert volume_iou(placed(mesh), placed(BALL)) == pytest.approx(1.0, abs=1e-6)


def test_a_missing_sliver_is_closed_and_a_missing_side_is_not():
    pinhole = trimesh.Trimesh(BALL.vertices, np.delete(BALL.faces, 100, axis=0), process=False)
    assert not pinhole.is_watertight
    coarse = volume_iou(placed(pinhole), placed(BALL), voxels=16)
    assert coarse == pytest.approx(1.0, abs=1e-6)
    open_box = trimesh.Trimesh(BOX.vertices, BOX.faces[BOX.face_normals[:, 1] > -0.5], process=False)
    sheet_only = volume_iou(placed(open_box), placed(BOX))
    assert 0.05 < sheet_only < 0.3
    assert volume_iou(placed(open_box), placed(open_box)) == 1.0


def test_a_gigantic_estimate_is_measured_on_a_coarser_grid():
    result = volume_iou(placed(scale=(20.0, 20.0, 20.0)), placed())
    assert 0 < result < 0.01


def test_chamfer_of_two_balls_is_the_difference_of_their_radii():
    fine = trimesh.creation.icosphere(subdivisions=5, radius=0.3)
    distance = surface_errors(placed(fine, scale=(1.5,) * 3), placed(fine))[0]
    assert distance == pytest.approx(0.15, rel=0.02)


def test_what_nobody_can_see_of_the_truth_is_not_missed():
    inside = trimesh.creation.box((0.3, 0.3, 0.3))
    filled = trimesh.util.concatenate([BOX, inside])
    assert isinstance(filled, trimesh.Trimesh)
    chamfer, recall = surface_errors(placed(), placed(filled))
    alone, _ = surface_errors(placed(), placed())
    assert recall > 0.99
    assert chamfer == pytest.approx(alone, rel=0.05)
    # what an estimate has inside is there, and wrong
    assert surface_errors(placed(filled), placed())[0] > 2 * alone


def test_faces_that_are_there_twice_are_seen():
    flat = trimesh.Trimesh(BOX.vertices, np.concatenate([BOX.faces, BOX.faces[:, ::-1]]), process=False)
    assert len(seen_points_on(placed(flat), 500)) == 500


def test_chamfer_is_in_metres_of_the_world():
    small = surface_errors(placed(T=rigid(translation=(0.05, 0, 0))), placed())[0]
    large = surface_errors(
        placed(T=rigid(translation=(0.15, 0, 0)), scale=(3, 3, 3)), placed(scale=(3, 3, 3))
    )[0]
    assert large == pytest.approx(3 * small, rel=1e-9)


def test_chamfer_points_are_uniform_by_area_whatever_the_triangles():
    # subdividing one side must not draw points to it
    part = BOX.face_normals[:, 0] > 0.5
    uneven = BOX.subdivide(face_index=np.nonzero(part)[0])
    for _ in range(3):
        uneven = uneven.subdivide(face_index=np.nonzero(uneven.face_normals[:, 0] > 0.5)[0])
    shifted = rigid(translation=(0.1, 0, 0))
    assert surface_errors(placed(uneven, shifted), placed())[0] == pytest.approx(
        surface_errors(placed(BOX, shifted), placed())[0], rel=0.03
    )


def test_chamfer_is_seeded():
    a, b = placed(T=rigid(translation=(0.03, 0, 0))), placed()
    assert surface_errors(a, b, seed=3) == surface_errors(a, b, seed=3)
    assert surface_errors(a, b, seed=3) != surface_errors(a, b, seed=4)


@pytest.mark.parametrize("seed", range(3))
def test_a_common_motion_changes_nothing(seed):
    rng = np.random.default_rng(seed)
    T, truth_T = rigid(rng.normal(size=3) * 0.2, rng.normal(size=3) * 0.05), rigid()
    motion = rigid(rng.normal(size=3), rng.normal(size=3))
    mesh, scale = table(), (1.1, 1.0, 0.9)
    before = evaluate(mesh, T, scale, truth_of(mesh, truth_T))
    after = evaluate(mesh, motion @ T, scale, truth_of(mesh, motion @ truth_T))
    assert after.box_iou == pytest.approx(before.box_iou, abs=1e-6)
    assert after.volume_iou == pytest.approx(
        before.volume_iou, abs=0.005
    )  # single precision at the voxels' edges
    assert after.chamfer_m == pytest.approx(before.chamfer_m, rel=1e-6)
    assert after.rotation_deg == pytest.approx(before.rotation_deg, abs=1e-5)


def test_the_side_at_fault_is_named():
    none = trimesh.Trimesh()
    with pytest.raises(EvaluationError, match=r"the estimate: .*empty"):
        evaluate(none, np.eye(4), (1, 1, 1), truth_of(BOX))
    with pytest.raises(EvaluationError, match=r"the ground truth: .*empty"):
        evaluate(BOX, np.eye(4), (1, 1, 1), truth_of(none))


def test_a_mesh_without_area_is_refused():
    # collinear triangles along a diagonal: the box has a volume, the surface no area
    needle = trimesh.Trimesh([[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 1, 2]], process=False)
    with pytest.raises(EvaluationError, match="no area"):
        surface_errors(placed(needle), placed())


def test_scan2cad_models_evaluate_against_themselves(shared_data):
    from objgraph.datasets import scannet

    scan = scannet.load(shared_data / "scannet")
    assert scan.ground_truth
    for truth in scan.ground_truth.values():
        result = evaluate_object(truth.T_world_object, truth.scale, truth.vertices, truth.faces, truth)
        assert result.pose_correct
        assert result.translation_m == pytest.approx(0, abs=1e-9)
        assert (result.box_iou, result.volume_iou) == pytest.approx((1, 1), abs=1e-6)
        assert result.chamfer_m < 0.012
