"""One model as a package of a build system, of Python or of ROS 2. Texts by path."""

import json
import keyword
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from zerodrift import __version__
from zerodrift.base.errors import InputError
from zerodrift.codegen.application import render_dbc
from zerodrift.codegen.generate import GeneratedCode, make_environment
from zerodrift.codegen.identifiers import list_flags, name_channels, sanitize_comment
from zerodrift.dataset.chip_codes import MEASURED
from zerodrift.export.integer_model import Channel, IntegerModel

# What packages share: headers and sources apart, and the inputs as a package's user gives them.

Files = dict[str, str]
"""Path inside the package, with forward slashes -> text."""


@dataclass(frozen=True)
class Given:
    """An input as a package's user gives it: in its unit, or as the code that the C converts."""

    channel: Channel
    field: str
    """In the C's struct."""
    in_unit: bool

    @property
    def unit(self) -> str:
        """The channel's unit; empty for a code of the hardware."""
        return self.channel.unit if self.in_unit else ""

    @property
    def lsb(self) -> float:
        """What a code is worth in what is given."""
        return self.channel.lsb if self.in_unit else 1.0

    @property
    def offset(self) -> float:
        """What code 0 stands for, in what is given."""
        return self.channel.offset if self.in_unit else 0.0

    @property
    def no_reading(self) -> int | None:
        """The code that says so, if the channel has one."""
        return self.channel.raw_lacks[0] if self.channel.raw_lacks else None


def list_given(model: IntegerModel) -> list[Given]:
    """Return the inputs in the order of the C's struct."""
    return [
        Given(channel, field, channel.conversion is None or channel.conversion.is_plain)
        for channel, field in zip(model.channels, name_channels(model), strict=True)
    ]


def split_code(code: GeneratedCode, runtime: Mapping[str, str]) -> tuple[Files, Files]:
    """Return headers and sources."""
    every = {code.header_name: code.header, code.source_name: code.source, **runtime}
    headers = {name: text for name, text in every.items() if name.endswith(".h")}
    return headers, {name: text for name, text in every.items() if name.endswith(".c")}


def lay_out(code: GeneratedCode, runtime: Mapping[str, str]) -> Files:
    """Return headers in include/ and sources in src/."""
    headers, sources = split_code(code, runtime)
    return {f"include/{n}": t for n, t in headers.items()} | {
        f"src/{n}": t for n, t in sources.items()
    }


# One model as a Python package: its C as a shared library, called by ctypes. Texts by path.

_TAKEN = ("self", "elapsed_s")
OLDEST_PYTHON = (3, 9)
"""The limited API's wheel holds from here on."""


def render_python(model: IntegerModel, code: GeneratedCode, runtime: Mapping[str, str]) -> Files:
    """Return a source tree that `pip wheel` makes one wheel per machine of, for all Pythons."""
    package = f"{code.prefix}_drift"
    given = list_given(model)
    names = [_name_argument(g) for g in given]
    environment = make_environment()
    environment.policies["json.dumps_kwargs"] = {"ensure_ascii": False}
    headers, sources = split_code(code, runtime)
    arguments = [
        f"{name}: float{' | None' if g.no_reading is not None else ''}"
        for name, g in zip(names, given, strict=True)
    ]
    context = {
        "title": sanitize_comment(model.name),
        "version": __version__,
        "hash": model.hash,
        "prefix": code.prefix,
        "PREFIX": code.prefix.upper(),
        "package": package,
        "period_s": model.sample_period_s,
        "channels": given,
        "outputs": model.outputs,
        "flags": list_flags(model),
        "variable": model.variable_step,
        "tare": model.tare,
        "arguments": ", ".join(arguments),
        "example": ", ".join(f"{name}=..." for name in names),
        "encoded": ", ".join(f"CHANNELS[{i}].encode({name})" for i, name in enumerate(names)),
    }
    compiled = [*sorted(f"src/{n}" for n in sources), "src/python_module.c"]
    oldest = ".".join(map(str, OLDEST_PYTHON))
    tag = "cp" + "".join(map(str, OLDEST_PYTHON))
    return {f"src/{name}": text for name, text in (headers | sources).items()} | {
        "src/python_module.c": environment.get_template("python_module.c.j2").render(context),
        f"{package}/__init__.py": environment.get_template("python_package.py.j2").render(context),
        f"{package}/py.typed": "",
        "MANIFEST.in": "include src/*.h\n",
        "pyproject.toml": f"""[build-system]
requires = ["setuptools>=70.1"]
build-backend = "setuptools.build_meta"

[project]
name = "{package.replace("_", "-")}"
version = "{__version__}"
description = "Temperature drift compensation, in the C that runs on the sensor's chip."
requires-python = ">={oldest}"

[tool.setuptools]
packages = ["{package}"]

[tool.setuptools.package-data]
{package} = ["py.typed"]
""",
        "setup.py": f"""from setuptools import Extension, setup

library = Extension(
    "{package}._model",
    sources={compiled},
    include_dirs=["src"],
    py_limited_api=True,
)
setup(ext_modules=[library], options={{"bdist_wheel": {{"py_limited_api": "{tag}"}}}})
""",
    }


def _name_argument(given: Given) -> str:
    is_taken = keyword.iskeyword(given.field) or given.field in _TAKEN
    return f"{given.field}_" if is_taken else given.field


# One model as a ROS 2 package: a node that takes the drift off a wrench. Texts by path.

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


# One model as a package of a build system, of Python or of ROS 2. Texts by path.

_SENTENCE = "Fixed-point temperature drift compensation, generated by zerodrift."


def render_package(
    kind: str, model: IntegerModel, code: GeneratedCode, runtime: Mapping[str, str]
) -> Files:
    """Return the files of a package.

    Args:
        kind: one of `PACKAGES`.
        model: the integer model.
        code: its C, as it was checked.
        runtime: the runtime's files, name -> text.
    """
    return PACKAGES[kind](model, code, runtime)


def render_cmake(model: IntegerModel, code: GeneratedCode, runtime: Mapping[str, str]) -> Files:
    """Return a CMake project that is added or installed, and found as `NAME::NAME`."""
    name = code.prefix
    sources = " ".join(f"src/{n}" for n in split_code(code, runtime)[1])
    return lay_out(code, runtime) | {
        f"{name}.dbc": render_dbc(model),
        "CMakeLists.txt": f"""cmake_minimum_required(VERSION 3.21)
project({name} VERSION {__version__} LANGUAGES C)
include(GNUInstallDirs)

# static, or shared with -DBUILD_SHARED_LIBS=ON
add_library({name} {sources})
add_library({name}::{name} ALIAS {name})
target_compile_features({name} PUBLIC c_std_99)
target_include_directories(
  {name} PUBLIC $<BUILD_INTERFACE:${{CMAKE_CURRENT_SOURCE_DIR}}/include>
                $<INSTALL_INTERFACE:${{CMAKE_INSTALL_INCLUDEDIR}}>)

install(TARGETS {name} EXPORT {name}-targets)
install(FILES include/{code.header_name} TYPE INCLUDE)
install(EXPORT {name}-targets FILE {name}-config.cmake NAMESPACE {name}::
        DESTINATION ${{CMAKE_INSTALL_LIBDIR}}/cmake/{name})
""",
    }


def render_zephyr(model: IntegerModel, code: GeneratedCode, runtime: Mapping[str, str]) -> Files:
    """Return a Zephyr module with a Kconfig switch."""
    name = code.prefix
    sources = "\n    ".join(f"src/{n}" for n in split_code(code, runtime)[1])
    return lay_out(code, runtime) | {
        f"{name}.dbc": render_dbc(model),
        "zephyr/module.yml": f"name: {name}\nbuild:\n  cmake: .\n  kconfig: Kconfig\n",
        "Kconfig": f"""config {name.upper()}
    bool "Drift compensation of {name}"
    help
      {_SENTENCE}
      Model {model.hash[:16]}.

config {name.upper()}_SMALL
    bool "Less flash, slower"
    depends on {name.upper()}
    help
      Leaves out the fast kernels and their tables. The results are the same bits.
""",
        "CMakeLists.txt": f"""if(CONFIG_{name.upper()})
  zephyr_include_directories(include)
  zephyr_library_named({name})
  zephyr_library_sources(
    {sources})
  if(CONFIG_{name.upper()}_SMALL)
    zephyr_compile_definitions(ZD_SMALL)
  endif()
endif()
""",
    }


def render_arduino(model: IntegerModel, code: GeneratedCode, runtime: Mapping[str, str]) -> Files:
    """Return an Arduino library with an example sketch."""
    name, upper = code.prefix, code.prefix.upper()
    headers, sources = split_code(code, runtime)
    channel = name_channels(model)[model.guards.temperature_channel]
    period_ms = round(model.sample_period_s * 1000)
    properties = {
        "name": f"{name}_drift",
        "version": __version__,
        "author": "zerodrift",
        "maintainer": "the owner of the model",
        "sentence": _SENTENCE,
        "paragraph": f"Model {model.hash[:16]}.",
        "category": "Sensors",
        "url": "https://example.invalid/zerodrift",
        "architectures": "*",
        "includes": code.header_name,
    }
    return {f"src/{n}": t for n, t in (headers | sources).items()} | {
        "library.properties": "".join(f"{key}={value}\n" for key, value in properties.items()),
        "keywords.txt": f"{name}_step\tKEYWORD2\n{name}_settle\tKEYWORD2\n",
        "examples/Compensate/Compensate.ino": f"""// Prints drifts and flags. Put your thermometer's
// reading and the other inputs where zeros stand.
#include <{code.header_name}>

static {name}_state_t state;

void setup() {{
    {name}_input_t in = {{}};
    Serial.begin(115200);
    if ({name}_selftest() != 0) {{
        Serial.println("self-test failed: use raw values");
    }}
    {name}_settle(&state, &in);
}}

void loop() {{
    {name}_input_t in = {{}};
    int32_t drift[{upper}_OUTPUTS];
    in.{channel} = 0;
    const uint32_t flags = {name}_step(&state, &in, drift);
    for (int k = 0; k < {upper}_OUTPUTS; k++) {{
        Serial.print(drift[k]);
        Serial.print(' ');
    }}
    Serial.println(flags);
    delay({period_ms});
}}
""",
    }


def render_platformio(
    model: IntegerModel, code: GeneratedCode, runtime: Mapping[str, str]
) -> Files:
    """Return a PlatformIO library."""
    manifest = {
        "name": f"{code.prefix.replace('_', '-')}-drift",
        "version": __version__,
        "description": _SENTENCE,
        "keywords": ["sensor", "temperature", "compensation"],
        "frameworks": "*",
        "platforms": "*",
        "headers": code.header_name,
        "build": {"srcDir": "src", "includeDir": "include", "flags": ["-std=c99"]},
    }
    return lay_out(code, runtime) | {
        f"{code.prefix}.dbc": render_dbc(model),
        "library.json": json.dumps(manifest, indent=2) + "\n",
    }


def render_esp_idf(model: IntegerModel, code: GeneratedCode, runtime: Mapping[str, str]) -> Files:
    """Return a component of ESP-IDF."""
    name = code.prefix
    sources = " ".join(f'"src/{n}"' for n in split_code(code, runtime)[1])
    return lay_out(code, runtime) | {
        f"{name}.dbc": render_dbc(model),
        "CMakeLists.txt": f"""idf_component_register(SRCS {sources}
                       INCLUDE_DIRS "include")
""",
        "idf_component.yml": f"""version: "{__version__}"
description: {_SENTENCE}
dependencies:
  idf: ">=4.4"
""",
    }


def render_pico(model: IntegerModel, code: GeneratedCode, runtime: Mapping[str, str]) -> Files:
    """Return an INTERFACE library as the Pico SDK's own are: sources join the program's."""
    name = code.prefix
    sources = "\n    ".join(
        f"${{CMAKE_CURRENT_LIST_DIR}}/src/{n}" for n in split_code(code, runtime)[1]
    )
    return lay_out(code, runtime) | {
        f"{name}.dbc": render_dbc(model),
        "CMakeLists.txt": f"""add_library({name} INTERFACE)
target_sources({name} INTERFACE
    {sources})
target_include_directories({name} INTERFACE ${{CMAKE_CURRENT_LIST_DIR}}/include)
""",
    }


PACKAGES: dict[str, Callable[[IntegerModel, GeneratedCode, Mapping[str, str]], Files]] = {
    "cmake": render_cmake,
    "zephyr": render_zephyr,
    "arduino": render_arduino,
    "platformio": render_platformio,
    "esp-idf": render_esp_idf,
    "pico": render_pico,
    "python": render_python,
    "ros2": render_ros2,
}
