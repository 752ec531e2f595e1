"""Reads ROS 2 bags by rosbags, with types of another distribution than they are written with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

#: A camera's axes in its link's: z ahead, x to the right, y down.
OPTICAL = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def read(bag: Path) -> dict[str, list[tuple[int, Any]]]:
    """Topic -> (log time, message), in the order that a player has."""
    store = get_typestore(Stores.ROS2_JAZZY)
    found: dict[str, list[tuple[int, Any]]] = {}
    with Reader(bag) as reader:
        for connection, time, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((time, message))
    return found


def matrix(transform: Any) -> NDArray:
    """A pose [4, 4] of a geometry_msgs/Transform."""
    pose = np.eye(4)
    q, t = transform.rotation, transform.translation
    pose[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    pose[:3, 3] = t.x, t.y, t.z
    return pose


def stamp(message: Any) -> int:
    """Nanoseconds of a message's header."""
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
