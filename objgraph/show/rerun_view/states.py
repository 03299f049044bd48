"""An object that is a state of its variables, not an entry of a map."""

import numpy as np
import rerun as rr

from factors.state import ObjectState
from objgraph.geometry.boxes import OrientedBox
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.shape_prior import ShapePrior
from objgraph.show.rerun_view.shapes import Rgb, Surface, box_shape, mesh_shape


def log_state(
    recording: rr.RecordingStream,
    path: str,
    prior: ShapePrior,
    state: ObjectState,
    label: str,
    rgb: Rgb,
    resolution: int,
) -> Surface:
    """An object's coarse mesh and the box about it, at the recording's time; raises SolveError of a code without surface."""
    mesh = extract_mesh(prior.decoder, state.code, resolution=resolution)
    vertices, faces = state.to_world(np.asarray(mesh.vertices)), np.asarray(mesh.faces)
    box = OrientedBox.about(vertices, state.T_world_object.rotation().matrix())
    recording.log(f"{path}/mesh", mesh_shape(vertices, faces, None, rgb))
    recording.log(f"{path}/box", box_shape(box, label, rgb))
    return Surface(vertices, faces)
