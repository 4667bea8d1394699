"""Rows 110 to 122: for a drive that moves the vehicle, and for a spout that travels. Pure."""

from gateway.core.setpoint import DriveState
from gateway.modbus.registers.register import INT16, MEASURED_FLOAT32, MEASURED_UINT16, UINT16, Register, named, shown

DRIVE: tuple[Register, ...] = (
    shown(110, "drive_enable", UINT16, 1, "drive.enable", "1: the drive may run at speed_setpoint; else 0"),
    shown(111, "drive_state", UINT16, 1, "drive.state", "how far the approach is; for people, decide on drive_enable",
          codes=named(DriveState)),
    shown(112, "speed_setpoint", INT16, 1, "drive.speed_setpoint_mm_s",
          "speed for the drive, towards the spout positive; 0 whenever it may not run"),
    shown(113, "stopping_distance", MEASURED_UINT16, 1, "drive.stopping_mm",
          "way until standstill from now, with the worst brake and all delays"),
    shown(114, "pose_x", MEASURED_FLOAT32, 1, "pose.x_mm"),
    shown(116, "pose_y", MEASURED_FLOAT32, 1, "pose.y_mm", "marker's centre minus its place, downwards"),
    shown(118, "pose_z", MEASURED_FLOAT32, 1, "pose.z_mm",
          "marker's centre minus its place, away from the camera; positive: to go"),
    shown(120, "pose_x_sd", MEASURED_UINT16, 0.1, "pose.x_sd_mm", "standard deviation of pose_x"),
    shown(121, "pose_y_sd", MEASURED_UINT16, 0.1, "pose.y_sd_mm", "standard deviation of pose_y"),
    shown(122, "pose_z_sd", MEASURED_UINT16, 0.1, "pose.z_sd_mm", "standard deviation of pose_z"),
)  # fmt: skip
