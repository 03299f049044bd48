"""Bags made up for the tests, by rosbags' own writers."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from objgraph.observation.frames import Frame, Scan
from tests.objgraph.datasets.dataset_folders import frames_of, jpeg, png, write_bytes, write_instances

START = 1_305_031_102_160_407_123
STEP = 33_333_333
KINDS = ("bag", "db3", "mcap")
SUFFIX = {"bag": ".bag", "db3": "", "mcap": ""}
DEPTH, COLOR = "/camera/aligned_depth_to_color/image_raw", "/camera/color/image_raw"
INFO = "/camera/aligned_depth_to_color/camera_info"
CAMERA = "camera_color_optical_frame"


class BagWriter:
    """Messages of one ROS version, written to a file in the order in which they are given."""

    def __init__(self, path: Path, kind: str = "bag") -> None:
        from rosbags.rosbag1 import Writer as Writer1
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        path.parent.mkdir(parents=True, exist_ok=True)
        self.ros1 = kind == "bag"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if self.ros1:
            tf = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(tf, "tf2_msgs/msg/TFMessage"))
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        self.file: Any = Writer1(path) if self.ros1 else Writer2(path, version=9, storage_plugin=plugin)
        self.connections: dict[str, Any] = {}
        self.logged = START + 10**9

    def __enter__(self) -> "BagWriter":
        self.file.open()
        return self

    def __exit__(self, *_) -> None:
        self.file.close()

    def make(self, name: str, **fields: Any) -> Any:
        """A message; fields that ROS 1 writes large are given small."""
        kind: Any = self.store.types[name]
        known = kind.__dataclass_fields__
        given = {key if key in known else key.upper(): value for key, value in fields.items()}
        return kind(**given)

    def header(self, stamp: int, frame: str) -> Any:
        time = self.make("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
        extra = {"seq": 0} if self.ros1 else {}
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame, **extra)

    def write(self, topic: str, message: Any) -> None:
        kind = message.__msgtype__
        if topic not in self.connections:
            self.connections[topic] = self.file.add_connection(topic, kind, typestore=self.store)
        data = (self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr)(message, kind)
        self.logged += 1000
        self.file.write(self.connections[topic], self.logged, data)

    def image(
        self, topic: str, stamp: int, frame: str, encoding: str, pixels: np.ndarray, fill: int = 0
    ) -> None:
        """`fill` are bytes at the end of each row."""
        rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
        data = np.pad(rows, ((0, 0), (0, fill)), constant_values=77)
        message = self.make(
            "sensor_msgs/msg/Image", header=self.header(stamp, frame), height=pixels.shape[0], width=pixels.shape[1],
            encoding=encoding, is_bigendian=0, step=data.shape[1], data=data.ravel(),
        )  # fmt: skip
        self.write(topic, message)

    def compressed(self, topic: str, stamp: int, frame: str, form: str, data: bytes) -> None:
        header = self.header(stamp, frame)
        pixels = np.frombuffer(data, np.uint8)
        self.write(
            topic, self.make("sensor_msgs/msg/CompressedImage", header=header, format=form, data=pixels)
        )

    def info(self, topic: str, stamp: int, frame: str, camera, distortion: float = 0.0) -> None:
        K = np.array([camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1.0])
        P = np.insert(K.reshape(3, 3), 3, 0, axis=1).ravel()
        roi = self.make(
            "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        message = self.make(
            "sensor_msgs/msg/CameraInfo", header=self.header(stamp, frame), height=camera.height, width=camera.width,
            distortion_model="plumb_bob", d=np.array([distortion, 0, 0, 0, 0]), k=K, r=np.eye(3).ravel(), p=P,
            binning_x=0, binning_y=0, roi=roi,
        )  # fmt: skip
        self.write(topic, message)

    def tf(self, topic: str, stamp: int, child: str, parent: str, T: np.ndarray) -> None:
        translation, rotation = self._vectors(T)
        transform = self.make(
            "geometry_msgs/msg/Transform",
            translation=self.make("geometry_msgs/msg/Vector3", **translation),
            rotation=self.make("geometry_msgs/msg/Quaternion", **rotation),
        )
        each = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(stamp, parent), child_frame_id=child, transform=transform,
        )  # fmt: skip
        self.write(topic, self.make("tf2_msgs/msg/TFMessage", transforms=[each]))

    def pose(self, topic: str, stamp: int, parent: str, T: np.ndarray, child: str | None = None) -> None:
        """A PoseStamped, or of a child the Odometry."""
        position, orientation = self._vectors(T)
        pose = self.make(
            "geometry_msgs/msg/Pose",
            position=self.make("geometry_msgs/msg/Point", **position),
            orientation=self.make("geometry_msgs/msg/Quaternion", **orientation),
        )
        header = self.header(stamp, parent)
        if child is None:
            self.write(topic, self.make("geometry_msgs/msg/PoseStamped", header=header, pose=pose))
            return
        zero = self.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        twist = self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        message = self.make(
            "nav_msgs/msg/Odometry", header=header, child_frame_id=child,
            pose=self.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
            twist=self.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )  # fmt: skip
        self.write(topic, message)

    @staticmethod
    def _vectors(T: np.ndarray) -> tuple[dict[str, float], dict[str, float]]:
        quaternion = Rotation.from_matrix(T[:3, :3]).as_quat()
        place = dict(zip("xyz", map(float, T[:3, 3]), strict=True))
        return place, dict(zip("xyzw", map(float, quaternion), strict=True))


def name_of(stamp: int) -> str:
    return f"{stamp // 10**9}.{stamp % 10**9:09d}"


def millimetres(frame: Frame) -> np.ndarray:
    return np.round(1000 * frame.depth).astype(np.uint16)


def write_images(bag: BagWriter, frame: Frame, stamp: int, depth: str = "16UC1", color: str = "rgb8") -> None:
    """Depth, colour 5 ms later and the camera, in one of the forms that cameras write."""
    if depth == "16UC1":
        bag.image(DEPTH, stamp, CAMERA, depth, millimetres(frame), fill=4)
    elif depth == "32FC1":
        metres = np.where(frame.depth > 0, frame.depth, np.nan).astype(np.float32)
        bag.image(DEPTH, stamp, CAMERA, depth, metres)
    else:
        header = b"" if depth == "png" else bytes(12)
        bag.compressed(f"{DEPTH}/{depth}", stamp, CAMERA, f"16UC1; {depth}", header + png(millimetres(frame)))
    assert frame.color is not None
    bgr = np.ascontiguousarray(frame.color[..., ::-1])
    if color == "jpeg":
        bag.compressed(
            f"{COLOR}/compressed", stamp + 5_000_000, CAMERA, "rgb8; jpeg compressed bgr8", jpeg(bgr)
        )
    else:
        codes = {"rgb8": None, "bgr8": bgr, "rgba8": cv2.COLOR_RGB2RGBA, "bgra8": cv2.COLOR_RGB2BGRA}
        code = codes[color]
        pixels = frame.color if code is None else bgr if code is bgr else cv2.cvtColor(frame.color, code)
        bag.image(COLOR, stamp + 5_000_000, CAMERA, color, np.asarray(pixels), fill=3)
    bag.info(INFO, stamp, CAMERA, frame.intrinsics)


def write_frames(bag: BagWriter, scan: Scan, **forms: str) -> list[int]:
    """The images of a scan at 30 Hz; gives their stamps."""
    stamps = [START + k * STEP for k in range(len(scan.frames))]
    for stamp, frame in zip(stamps, frames_of(scan), strict=True):
        write_images(bag, frame, stamp, **forms)
    return stamps


def write_poses(bag: BagWriter, scan: Scan, stamps: list[int], how: str) -> None:
    """Each frame's pose at its time: by tf in three links, odometry of the robot's base, or a pose."""
    T_base_camera = np.eye(4)
    T_base_camera[:3, :3] = Rotation.from_euler("xyz", [-90, 0, -90], degrees=True).as_matrix()
    T_base_camera[:3, 3] = [0.1, -0.2, 0.9]
    T_map_odom = np.eye(4)
    T_map_odom[:3, :3] = Rotation.from_euler("z", 30, degrees=True).as_matrix()
    if how != "pose":
        bag.tf("/tf_static", stamps[0] - 10**9, CAMERA, "base_link", T_base_camera)
    for stamp, frame in zip(stamps, frames_of(scan), strict=True):
        T_map_base = frame.T_world_camera @ np.linalg.inv(T_base_camera)
        if how == "tf":
            bag.tf("/tf", stamp, "odom", "map", T_map_odom)
            bag.tf("/tf", stamp, "base_link", "odom", np.linalg.inv(T_map_odom) @ T_map_base)
        elif how == "odometry":
            bag.pose("/odom", stamp, "map", T_map_base, "base_link")
        else:
            bag.pose("/camera_pose", stamp, "map", frame.T_world_camera)


def write_masks(folder: Path, scan: Scan, stamps: list[int]) -> None:
    for stamp, frame in zip(stamps, frames_of(scan), strict=True):
        write_bytes(folder / "masks" / f"{name_of(stamp)}.png", png(frame.instances.astype(np.uint8)))
    write_instances(folder, scan)


def write_recording(folder: Path, scan: Scan, kind: str = "bag", how: str = "tf", **forms: str) -> Path:
    """A bag with masks beside it; gives the bag."""
    path = folder / f"run{SUFFIX[kind]}"
    with BagWriter(path, kind) as bag:
        stamps = write_frames(bag, scan, **forms)
        write_poses(bag, scan, stamps, how)
    write_masks(folder, scan, stamps)
    return path
