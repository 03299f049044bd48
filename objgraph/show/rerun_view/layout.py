"""How the viewer's window is divided; whoever moves something has it his way."""

import numpy as np
import rerun.blueprint as rrb
from jaxtyping import Float

from objgraph.maps.object_map import ObjectMap
from objgraph.show.framing import framing_camera, intrinsics_for, oblique_direction
from objgraph.show.rerun_view import paths

_AZIMUTH, _ELEVATION = np.radians(-60), np.radians(35)
_WINDOW = (900, 700)
"""Of the 3D view, in pixels."""
_NEARER = 0.7
"""The viewer's field of view is wider than that of the project's pictures."""


def map_layout(object_map: ObjectMap, *, frames: bool, solved: int | None = None) -> rrb.Blueprint:
    """3D over the table; beside them the cameras' pictures, where there are `frames`.

    With the id of an object that was `solved` again: its iterates in its place, and their cost.
    """
    vertices = [entry.vertices for entry in object_map.mapped if entry.vertices is not None]
    eye = None if not vertices else _eye(np.concatenate(vertices), object_map.up_world)
    replaced = [paths.object_path(entry.name) for entry in object_map.objects if entry.id == solved]
    if solved is not None:
        replaced.append(paths.CAMERA)
    left = rrb.Vertical(
        _space(eye, tuple(f"{path}/**" for path in replaced)),
        rrb.TextDocumentView(origin=paths.TABLE, name="objects"),
        row_shares=[5, 2],
    )
    if solved is not None:
        cost = rrb.TimeSeriesView(origin=paths.COST, name="cost", axis_y=rrb.ScalarAxis(zoom_lock=False))
        return _blueprint(rrb.Horizontal(left, cost, column_shares=[3, 1]), paths.ITERATION)
    return _blueprint(_beside_cameras(left) if frames else left, paths.FRAME)


def incremental_layout() -> rrb.Blueprint:
    """3D over how sure the objects' places are; beside them the camera's pictures."""
    sigma = rrb.TimeSeriesView(origin=paths.SIGMA, name="object's place ±, cm")
    return _blueprint(_beside_cameras(rrb.Vertical(_space(None, ()), sigma, row_shares=[3, 1])), paths.FRAME)


def _space(eye: rrb.EyeControls3D | None, without: tuple[str, ...]) -> rrb.Spatial3DView:
    """Depth and masks would hide in 3D what they are measurements of."""
    hidden = [f"- /{path}" for path in (paths.DEPTH, paths.MASKS, *without)]
    return rrb.Spatial3DView(
        origin=paths.WORLD, contents=["+ $origin/**", *hidden], name="map", eye_controls=eye
    )


def _beside_cameras(left: rrb.Vertical) -> rrb.Horizontal:
    shown = [f"+ /{path}" for path in (paths.COLOR, paths.MASKS, paths.OUTLINES)]
    pictures = rrb.Vertical(
        rrb.Spatial2DView(origin=paths.CAMERA, contents=shown, name="colour, masks, estimates"),
        rrb.Spatial2DView(origin=paths.CAMERA, contents=[f"+ /{paths.DEPTH}"], name="depth"),
    )
    return rrb.Horizontal(left, pictures, column_shares=[2, 1])


def _eye(p_world: Float[np.ndarray, "n 3"], up_world: Float[np.ndarray, "3"]) -> rrb.EyeControls3D:
    """From obliquely above, all objects in sight."""
    direction = oblique_direction(up_world, _AZIMUTH, _ELEVATION)
    camera = framing_camera(p_world, direction, up_world, intrinsics_for(*_WINDOW), fill=0.75)
    target = (p_world.min(axis=0) + p_world.max(axis=0)) / 2
    position = target + _NEARER * (camera.T_world_camera[:3, 3] - target)
    return rrb.EyeControls3D(position=position, look_target=target, eye_up=up_world)


def _blueprint(root: rrb.Horizontal | rrb.Vertical, timeline: str) -> rrb.Blueprint:
    return rrb.Blueprint(root, rrb.TimePanel(timeline=timeline, state="collapsed"), collapse_panels=True)
