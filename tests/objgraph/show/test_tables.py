"""The tables, and the small functions behind their numbers."""

import io
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console
from scipy.spatial.transform import Rotation

from objgraph.maps.mapped_object import MappedObject
from objgraph.maps.object_map import ObjectMap
from objgraph.metrics.maps import MapErrors
from objgraph.metrics.tables import evaluation_summary, evaluation_table
from objgraph.show import summary
from objgraph.show.tables import map_table
from objgraph.trust.verdict import Trust

UP = np.array([0.0, 0.0, 1.0])
Y_UP_TO_Z_UP = Rotation.from_euler("x", 90, degrees=True)
"""Takes the canonical frame's y to the world's z; its front, -z, to the world's y."""


def pose(rotation: Rotation, translation=(0.0, 0.0, 0.0)) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = rotation.as_matrix()
    T[:3, 3] = translation
    return T


def turned(yaw: float) -> Rotation:
    return Rotation.from_rotvec(yaw * UP) * Y_UP_TO_Z_UP


@given(yaw=st.floats(-3.1, 3.1))
def test_heading_is_the_angle_of_the_front_about_up(yaw):
    T = pose(turned(yaw - np.pi / 2))
    assert np.isclose(np.angle(np.exp(1j * (summary.heading(T, UP) - yaw))), 0, atol=1e-9)
    front = np.array([np.cos(yaw), np.sin(yaw), 0])
    np.testing.assert_allclose(T[:3, :3] @ [0, 0, -1], front, atol=1e-9)


@pytest.mark.parametrize("up", [[1.0, 0, 0], [0, -1.0, 0], [0.6, 0, 0.8]])
def test_heading_grows_counter_clockwise_about_any_up(up):
    up = np.array(up)
    start = pose(Rotation.align_vectors([up], [[0, 1, 0]])[0])
    turned_on = pose(Rotation.from_rotvec(0.3 * up) * Rotation.from_matrix(start[:3, :3]))
    step = summary.heading(turned_on, up) - summary.heading(start, up)
    assert np.isclose(np.angle(np.exp(1j * step)), 0.3)


def test_standard_deviations_of_known_axes():
    covariance = np.diag([1e-4, 4e-4, 9e-4, 0.01, 0.04, 0.09, 1, 1, 1])
    T = pose(Y_UP_TO_Z_UP)
    assert summary.heading_sigma(T, covariance, UP) == pytest.approx(0.02)  # the object's y is up
    np.testing.assert_allclose(summary.position_sigma(T, covariance), [0.1, 0.3, 0.2])
    covariance[1, 1] = 400.0
    assert np.degrees(summary.heading_sigma(T, covariance, UP)) == pytest.approx(103.9, abs=0.1)


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_standard_deviations_agree_with_samples_drawn_in_gtsams_tangent(seed):
    rng = np.random.default_rng(seed)
    T = pose(turned(rng.uniform(-3, 3)), rng.normal(size=3))
    root = 0.01 * rng.normal(size=(9, 9))
    covariance = root @ root.T
    samples = rng.multivariate_normal(np.zeros(9), covariance, 4000)
    start = gtsam.Pose3(T)
    poses = np.array([start.retract(row[:6]).matrix() for row in samples])
    spread = np.cov(poses[:, :3, 3].T)
    expected = summary.position_covariance(T, covariance)
    np.testing.assert_allclose(spread, expected, atol=0.12 * np.trace(expected))
    turn = np.array([summary.heading(sample, UP) for sample in poses]) - summary.heading(T, UP)
    turn = np.angle(np.exp(1j * turn))
    assert np.std(turn) == pytest.approx(summary.heading_sigma(T, covariance, UP), rel=0.08)


def example() -> ObjectMap:
    covariance = np.diag([1e-4, 4e-4, 9e-4, 0.01, 0.04, 0.09, 1, 1, 1])
    chair = MappedObject(
        1,
        "chair [r]",
        "mapped",
        T_world_object=pose(turned(0), (1, 2, 0.5)),
        scale=np.ones(3),
        code=np.zeros(2),
        covariance=covariance,
        trust=Trust(0.55, 0.3, ("little of its surface is seen", "two headings fit")),
        cost_initial=4210.2,
        cost_final=312.77,
        seconds=4.34,
        views=("0", "3", "9"),
        size_m=np.array([0.61, 0.92, 0.58]),
    )
    table = MappedObject(
        2,
        "table",
        "mapped",
        T_world_object=np.eye(4),
        scale=np.ones(3),
        code=np.zeros(2),
    )
    lost = MappedObject(3, "chair", "failed", "12 [px] seen")
    return ObjectMap("room [a]", (chair, table, lost), UP)


ERRORS = MapErrors(
    "room [a]",
    {
        1: {
            "pose_correct": True,
            "translation_m": 0.034,
            "rotation_deg": 2.5,
            "scale_pct": 3.1,
            "box_iou": 0.61,
            "chamfer_m": 0.042,
        },
        2: {"pose_correct": False, "box_iou": 0.25, "chamfer_m": 0.06, "rotation_deg": 40.0},
        3: {"pose_correct": False},
    },
)


def test_another_heading_that_is_likely_is_told():
    chair, table, lost = example().objects
    doubtful = replace(table, turns=np.array([0.55, 0.02, 0.31, 0.12]))
    told = text(map_table(ObjectMap("room", (chair, doubtful, lost), UP)))
    assert "table 2: may stand turned by 180° (31 %) or 270° (12 %)" in told
    sure = replace(table, turns=np.array([0.94, 0.02, 0.02, 0.02]))
    assert "turned" not in text(map_table(ObjectMap("room", (chair, sure, lost), UP)))


def text(table, width=200) -> str:
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(table)
    return console.export_text()


def test_what_is_printed_is_the_calibrated_box_and_the_raw_is_marked():
    chair, table, lost = example().objects
    wider = np.diag([4e-4, 16e-4, 36e-4, 0.04, 0.16, 0.36, 1, 1, 1])
    boxed = replace(chair, box_centre=np.array([1.1, 2.2, 0.6]), box_extents=np.ones(3), box_covariance=wider)
    raw = replace(table, covariance=wider)
    printed = text(map_table(ObjectMap("room", (boxed, raw, lost), UP)))
    lines = printed.splitlines()
    (row,) = [line for line in lines if "1 chair [r]" in line]
    assert "1.10±0.200, 2.20±0.600, 0.60±0.400" in row
    assert "90±2.3" in row
    assert "1.00x1.00x1.00" in row  # of the same box, not of the mesh
    assert "two headings fit; the mesh has 61 % of its width and 58 % of its depth" in " ".join(
        printed.split()
    )
    assert "~" not in row
    (row,) = [line for line in lines if " table " in line]
    assert "~0.00±0.200" in row
    assert "± of the box, calibrated" in printed
    assert "~ place of the origin, ± the estimator's own: not calibrated, too small" in printed
    calibrated = text(map_table(ObjectMap("room", (boxed, table, lost), UP)))
    assert "~" not in calibrated


def test_the_map_table_shows_every_number_in_its_unit():
    lines = text(map_table(example())).splitlines()
    (chair,) = [line for line in lines if "1 chair [r]" in line]
    for piece in (
        "0.61x0.92x0.58",
        "~1.00±0.100, 2.00±0.300, 0.50±0.200",
        "90±1.1",
        "doubtful",
        " 3 ",
        "4.3",
    ):
        assert piece in chair
    assert any("55 %" in line for line in lines)
    assert any("chair [r] 1: little of its surface is seen; two headings fit" in line for line in lines)
    assert any("chair 3: 12 [px] seen" in line for line in lines)
    assert "room [a]: 2 of 3 objects mapped" in lines[0]


def test_the_map_table_fits_a_narrow_terminal():
    lines = text(map_table(example()), width=80).splitlines()
    for piece in ("0.61x0.92x0.58", "1.00±0.100", "2.00±0.300", "90±1.1"):
        assert any(piece in line for line in lines), piece
    rows = [line.rstrip().rsplit(maxsplit=1)[-1] for line in lines if line.strip()[:2] in ("1 ", "2 ", "3 ")]
    assert rows == ["mapped", "mapped", "failed"]
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize("category", ["swivel office chair with arms", "x" * 300])
def test_a_long_name_takes_no_other_column_s_place(category):
    chair = replace(
        example().objects[0], category=category, box_centre=np.array([-12.345, 2.345, 1.0]),
        box_extents=np.array([1.2, 0.8, 0.9]), box_covariance=1e-3 * np.eye(9), seconds=12.3,
    )  # fmt: skip
    printed = text(map_table(ObjectMap("room", (chair,), UP)), width=80)
    (row,) = [line for line in printed.splitlines() if line.lstrip().startswith("1 ")]
    for piece in ("1.20x0.80x0.90", "doubtful", " 3 ", "12.3", "mapped"):
        assert piece in row
    for piece in ("-12.35±0.032", "2.35±0.032", "1.00±0.032", "90±1.8", "views", "status", "object"):
        assert piece in printed
    assert max(map(len, printed.splitlines())) <= 80


def test_the_evaluation_table_judges_each_object():
    lines = text(evaluation_table(example(), ERRORS)).splitlines()
    (chair,) = [line for line in lines if "chair [r]" in line]
    for piece in ("3.4", "2.5", "3.1", "0.61", "4.2"):
        assert piece in chair
    assert chair.count("✓") == 3
    (table,) = [line for line in lines if "table" in line]
    assert (table.count("✓"), table.count("✗")) == (1, 2)  # an overlap of exactly 0.25 is not above it


def test_the_summary_counts_failed_objects_as_failures():
    assert evaluation_summary(ERRORS) == (
        "pose: 1 of 3, IoU > 0.25: 1 of 3, Chamfer < 20 cm: 2 of 3, median Chamfer 5.1 cm (2 measured)"
    )


def test_without_ground_truth_there_is_no_evaluation_table():
    lost = MappedObject(3, "chair", "failed", "seen in 12 pixels")
    assert evaluation_table(ObjectMap("room", (lost,), UP), MapErrors("room", {})) is None
