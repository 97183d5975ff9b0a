"""ROS 1 and ROS 2 bags: .bag, .mcap, .db3 or the folder of a recording.

Robot: the TCP pose (`tcp_pose_broadcaster/pose`, or the transforms from the base to the tool), JointState by joint
name (else a controller's state), the speed scaling in the unit of the driver that writes it, whether the program runs,
and UR's modes. People: PoseArray, PoseStamped and PointStamped whose topic speaks of people; the messages of Azure
Kinect, SPENCER, people_msgs and ZED; the bodies of ROS4HRI; brought into the robot's base where transforms lead there.
Events: String, Bool and modes. Metres, radians, seconds since 1970; the time of each topic is its header's, put on the
recorder's clock where it is of another one, else the moment of recording. Topics that nobody needs are skipped; which
topic means what can be set in `[sources.map]`.
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
        from cyclekit_adapters.rosbag.reading import read_bag  # a tenth of a second that no text log needs

        return read_bag(path, options)


ADAPTER: Adapter = _RosBag()
