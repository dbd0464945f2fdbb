"""Units of the fields of common message types."""

from collections.abc import Mapping

ANGLE_NAMES = (
    "yaw", "roll", "pitch", "heading", "course", "bearing", "angle", "theta", "azimuth",
)  # fmt: skip

#: Unit by message type and field; it holds for all numbers inside of the field.
UNITS: Mapping[tuple[str, str], str] = {
    ("geometry_msgs/msg/Accel", "linear"): "m/s^2",
    ("geometry_msgs/msg/Accel", "angular"): "rad/s^2",
    ("geometry_msgs/msg/Pose", "position"): "m",
    ("geometry_msgs/msg/PointStamped", "point"): "m",
    ("geometry_msgs/msg/Transform", "translation"): "m",
    ("geometry_msgs/msg/Twist", "linear"): "m/s",
    ("geometry_msgs/msg/Twist", "angular"): "rad/s",
    ("geometry_msgs/msg/Wrench", "force"): "N",
    ("geometry_msgs/msg/Wrench", "torque"): "N m",
    ("ackermann_msgs/msg/AckermannDrive", "steering_angle"): "rad",
    ("ackermann_msgs/msg/AckermannDrive", "steering_angle_velocity"): "rad/s",
    ("ackermann_msgs/msg/AckermannDrive", "speed"): "m/s",
    ("ackermann_msgs/msg/AckermannDrive", "acceleration"): "m/s^2",
    ("sensor_msgs/msg/BatteryState", "voltage"): "V",
    ("sensor_msgs/msg/BatteryState", "current"): "A",
    ("sensor_msgs/msg/BatteryState", "temperature"): "degC",
    ("sensor_msgs/msg/FluidPressure", "fluid_pressure"): "Pa",
    ("sensor_msgs/msg/Imu", "angular_velocity"): "rad/s",
    ("sensor_msgs/msg/Imu", "linear_acceleration"): "m/s^2",
    ("sensor_msgs/msg/JointState", "velocity"): "rad/s",
    ("sensor_msgs/msg/LaserScan", "ranges"): "m",
    ("sensor_msgs/msg/MagneticField", "magnetic_field"): "T",
    ("sensor_msgs/msg/NavSatFix", "latitude"): "deg",
    ("sensor_msgs/msg/NavSatFix", "longitude"): "deg",
    ("sensor_msgs/msg/NavSatFix", "altitude"): "m",
    ("sensor_msgs/msg/Range", "range"): "m",
    ("sensor_msgs/msg/Temperature", "temperature"): "degC",
}


def period_of(name: str, unit: str, largest: float) -> float:
    """Return the period of an angle in its unit, 0 if a signal is not an angle.

    Parameters
    ----------
    name : str
        Of the signal, such as ``controller.yaw``.
    unit : str
        Empty if it is unknown.
    largest : float
        Largest magnitude of its values; radians beyond two turns are degrees.

    Examples
    --------
    >>> period_of("attitude.yaw", "", 170.0), period_of("twist.angular.z", "rad/s", 1.0)
    (360.0, 0.0)
    """
    last = name.rpartition(".")[2].partition("[")[0].lower()
    if unit not in ("", "rad", "deg") or not last.endswith(ANGLE_NAMES):
        return 0.0
    in_degrees = unit == "deg" or (not unit and largest > 4.0 * _PI)
    return 360.0 if in_degrees else 2.0 * _PI


_PI = 3.141592653589793
