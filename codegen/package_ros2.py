"""One model as a ROS 2 package: a node that takes the drift off a wrench. Texts by path."""

from collections.abc import Mapping
from dataclasses import dataclass

from zerodrift import __version__
from zerodrift.base.errors import InputError
from zerodrift.codegen.generate import GeneratedCode, make_environment
from zerodrift.codegen.identifiers import sanitize_comment
from zerodrift.codegen.names import name_channels
from zerodrift.dataset.code_format import MEASURED
from zerodrift.export.integer_model import Channel, IntegerModel

MEMBERS = {
    **{f"F{axis}": (f"force.{axis}", "N") for axis in "xyz"},
    **{f"{letter}{axis}": (f"torque.{axis}", "Nm") for letter in "MT" for axis in "xyz"},
}
"""Output -> its place in a geometry_msgs/Wrench, and the unit that a wrench has."""
UNSURE = 128
"""The application's flag; the model has none of this value."""
PERIODS = 5.0
"""An input may be so many sample periods old, ..."""
LEAST_TIMEOUT_S = 1.0
"""... and this at least."""


@dataclass(frozen=True)
class _Input:
    """An input of the node."""

    index: int
    field: str
    """In the C's struct."""
    topic: str
    """Empty: a part of the measured wrench."""
    message: str
    cpp: str
    member: str
    """Of the message, or of the wrench."""
    told: str
    lsb: float
    offset: float
    least: int
    most: int
    no_reading: int | None
    type: str


@dataclass(frozen=True)
class _Output:
    member: str
    lsb_per_unit: int


def render_ros2(
    model: IntegerModel, code: GeneratedCode, runtime: Mapping[str, str]
) -> dict[str, str]:
    """Return an ament_cmake package with the model and its node.

    Raises:
        InputError: an output is no part of a wrench, or in another unit.
    """
    outputs = [_Output(_place(o.name, o.unit)[0], o.lsb_per_unit) for o in model.outputs]
    inputs = [_describe(model, index, name) for index, name in enumerate(name_channels(model))]
    every = {code.header_name: code.header, code.source_name: code.source, **runtime}
    name = f"{code.prefix}_drift"
    sources = " ".join(f"src/{n}" for n in sorted(every) if n.endswith(".c"))
    node = (
        make_environment()
        .get_template("ros2_node.cpp.j2")
        .render(
            title=sanitize_comment(model.name),
            version=__version__,
            hash=model.hash,
            prefix=code.prefix,
            PREFIX=code.prefix.upper(),
            class_name="".join(part.capitalize() for part in code.prefix.split("_")) + "Node",
            UNSURE=UNSURE,
            period_s=model.sample_period_s,
            period_us=model.period_us,
            timeout_s=max(LEAST_TIMEOUT_S, PERIODS * model.sample_period_s),
            channels=inputs,
            outputs=outputs,
        )
    )
    return {
        **{f"include/{n}": t for n, t in every.items() if n.endswith(".h")},
        **{f"src/{n}": t for n, t in every.items() if n.endswith(".c")},
        f"src/{code.prefix}_node.cpp": node,
        "CMakeLists.txt": f"""cmake_minimum_required(VERSION 3.8)
project({name} LANGUAGES C CXX)
set(CMAKE_C_STANDARD 99)
set(CMAKE_CXX_STANDARD 17)
find_package(ament_cmake REQUIRED)
find_package(rclcpp REQUIRED)
find_package(geometry_msgs REQUIRED)
find_package(sensor_msgs REQUIRED)
find_package(std_msgs REQUIRED)

add_executable({code.prefix}_node src/{code.prefix}_node.cpp {sources})
target_include_directories({code.prefix}_node PRIVATE include)
ament_target_dependencies({code.prefix}_node rclcpp geometry_msgs sensor_msgs std_msgs)

install(TARGETS {code.prefix}_node DESTINATION lib/${{PROJECT_NAME}})
ament_package()
""",
        "package.xml": f"""<?xml version="1.0"?>
<package format="3">
  <name>{name}</name>
  <version>{__version__}</version>
  <description>Takes the temperature drift off a wrench; model {model.hash[:16]}.</description>
  <maintainer email="owner@example.invalid">the owner of the model</maintainer>
  <license>any terms</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <depend>rclcpp</depend>
  <depend>geometry_msgs</depend>
  <depend>sensor_msgs</depend>
  <depend>std_msgs</depend>
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
""",
    }


def _place(name: str, unit: str) -> tuple[str, str]:
    place = MEMBERS.get(name)
    if place is None or place[1] != unit:
        wanted = ", ".join(f"{n} in {u}" for n, (_, u) in MEMBERS.items() if n[0] != "T")
        raise InputError(
            f"package ros2: output {name} in {unit} is no part of a wrench; expected some of"
            f" {wanted}. Name the outputs so in zerodrift.toml, or take `package cmake` and a node"
            " of your own."
        )
    return place


def _describe(model: IntegerModel, index: int, field: str) -> _Input:
    channel: Channel = model.channels[index]
    by = channel.conversion
    in_unit = by is None or by.is_plain
    source = channel.source or channel.name
    if source.startswith(MEASURED):
        topic, message, cpp = "", "", ""
        member = _place(source.removeprefix(MEASURED), channel.unit)[0]
        told = ""
    elif index == model.guards.temperature_channel and in_unit:
        topic, message, cpp = (
            "temperature",
            "sensor_msgs/Temperature",
            "sensor_msgs::msg::Temperature",
        )
        member, told = "temperature", f"in {channel.unit}"
    else:
        topic, message, cpp = f"input/{field}", "std_msgs/Float64", "std_msgs::msg::Float64"
        unit = channel.unit if in_unit else "codes of the hardware"
        member, told = "data", f"in {unit}"
    return _Input(
        index=index,
        field=field,
        topic=topic,
        message=message,
        cpp=cpp,
        member=member,
        told=sanitize_comment(told),
        lsb=channel.lsb if in_unit else 1.0,
        offset=channel.offset if in_unit else 0.0,
        least=channel.raw_least,
        most=channel.raw_most,
        no_reading=channel.raw_lacks[0] if channel.raw_lacks else None,
        type=channel.raw_type,
    )
