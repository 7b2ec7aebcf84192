"""One model as a ROS 2 package: a node that takes the drift off a wrench. Texts by path."""

from collections.abc import Mapping
from dataclasses import dataclass

from zerodrift import __version__
from zerodrift.base.errors import InputError
from zerodrift.codegen.generate import GeneratedCode, make_environment
from zerodrift.codegen.identifiers import sanitize_comment
from zerodrift.codegen.package_parts import Files, Given, lay_out, list_given, split_code
from zerodrift.dataset.code_format import MEASURED
from zerodrift.export.integer_model import IntegerModel

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
    given: Given
    topic: str
    """Empty: a part of the measured wrench."""
    message: str
    cpp: str
    member: str
    """Of the message, or of the wrench."""
    told: str


@dataclass(frozen=True)
class _Output:
    member: str
    lsb_per_unit: int


def render_ros2(model: IntegerModel, code: GeneratedCode, runtime: Mapping[str, str]) -> Files:
    """Return an ament_cmake package with the model and its node.

    Raises:
        InputError: an output is no part of a wrench, or in another unit.
    """
    outputs = [_Output(_place(o.name, o.unit)[0], o.lsb_per_unit) for o in model.outputs]
    inputs = [_describe(model, index, given) for index, given in enumerate(list_given(model))]
    name = f"{code.prefix}_drift"
    sources = " ".join(f"src/{n}" for n in sorted(split_code(code, runtime)[1]))
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
        **lay_out(code, runtime),
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


def _describe(model: IntegerModel, index: int, given: Given) -> _Input:
    source = given.channel.source or given.channel.name
    if source.startswith(MEASURED):
        member = _place(source.removeprefix(MEASURED), given.channel.unit)[0]
        return _Input(index, given, "", "", "", member, "")
    if index == model.guards.temperature_channel and given.in_unit:
        message, member = "Temperature", "temperature"
        topic, package = "temperature", "sensor_msgs"
    else:
        message, member = "Float64", "data"
        topic, package = f"input/{given.field}", "std_msgs"
    told = sanitize_comment(f"in {given.unit or 'codes of the hardware'}")
    cpp = f"{package}::msg::{message}"
    return _Input(index, given, topic, f"{package}/{message}", cpp, member, told)
