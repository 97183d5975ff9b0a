"""ROS 1 and ROS 2 bags: .bag, .mcap, .db3 or the folder of a recording.

Robot: the TCP pose (`tcp_pose_broadcaster/pose`, or the transforms from base to tool), JointState by joint name (else a
controller's state), the speed scaling in the unit of its driver, the program state, and UR's modes. People: PoseArray,
PoseStamped and PointStamped on topics with a word for people; messages of Azure Kinect, SPENCER, people_msgs and ZED;
the bodies of ROS4HRI; transformed to the robot's base if the bag holds the transforms. Events: String, Bool and modes.
Units are m, rad and s since 1970. The time of each topic is its header's, mapped to the recorder's clock if it differs,
else the receive time. Unused topics are skipped; `[sources.map]` can assign topics.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit_adapters.rosbag.first_bytes import is_bag

if TYPE_CHECKING:
    from pathlib import Path

    from cyclekit.adapter import Adapter, ReadOptions, Recording


class _RosBag:
    def recognises(self, path: Path) -> bool:
        return is_bag(path)

    def read(self, path: Path, options: ReadOptions) -> Recording:
        from cyclekit_adapters.rosbag.reading import read_bag  # takes a tenth of a second, which text logs do not need

        return read_bag(path, options)


ADAPTER: Adapter = _RosBag()
