"""A ROS 2 node that publishes the vehicle: Odometry in ENU and FLU, and the wrench of the thrusters."""

from __future__ import annotations

import math
import sys
import time

import rclpy
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from played import paced


def quaternion(phi: float, theta: float, psi: float) -> tuple[float, float, float, float]:
    """Return x y z w of an attitude from FLU to ENU, given that from FRD to NED."""
    roll, pitch, yaw = phi, -theta, math.pi / 2 - psi
    cr, sr, cp, sp = math.cos(roll / 2), math.sin(roll / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


rclpy.init()
node = rclpy.create_node("vehicle")
odometry, thrust = node.create_publisher(Odometry, "/odom", 50), node.create_publisher(WrenchStamped, "/thrust", 50)
for _, frame in paced(sys.argv[1]):
    stamp = time.time()
    pose, force = Odometry(), WrenchStamped()
    for header in (pose.header, force.header):
        header.stamp.sec, header.stamp.nanosec = int(stamp), int(1e9 * (stamp % 1.0))
    pose.header.frame_id, pose.child_frame_id, force.header.frame_id = "odom", "base_link", "base_link"
    (x, y, z, *angles), (u, v, w, p, q, r) = frame["eta"], frame["nu"]
    place, turn, twist = pose.pose.pose.position, pose.pose.pose.orientation, pose.twist.twist
    place.x, place.y, place.z = y, x, -z
    turn.x, turn.y, turn.z, turn.w = quaternion(*angles)
    twist.linear.x, twist.linear.y, twist.linear.z = u, -v, -w
    twist.angular.x, twist.angular.y, twist.angular.z = p, -q, -r
    tau = frame["tau"]
    force.wrench.force.x, force.wrench.force.y, force.wrench.force.z = tau[0], -tau[1], -tau[2]
    force.wrench.torque.x, force.wrench.torque.y, force.wrench.torque.z = tau[3], -tau[4], -tau[5]
    odometry.publish(pose)
    thrust.publish(force)
