"""One model as a Python package: its C as a shared library, called by ctypes. Texts by path."""

import keyword
from collections.abc import Mapping
from dataclasses import dataclass

from zerodrift import __version__
from zerodrift.codegen.generate import GeneratedCode, make_environment
from zerodrift.codegen.identifiers import sanitize_comment
from zerodrift.codegen.names import list_flags, name_channels
from zerodrift.export.integer_model import Channel, IntegerModel

_TAKEN = ("self", "elapsed_s")
OLDEST_PYTHON = (3, 9)
"""The limited API's wheel holds from here on."""


@dataclass(frozen=True)
class _Given:
    """An input as the package's user gives it: in its unit, or as the code that the C converts."""

    name: str
    field: str
    """In the C's struct."""
    argument: str
    unit: str
    lsb: float
    offset: float
    least: int
    most: int
    no_reading: int | None
    type: str


def render_python(
    model: IntegerModel, code: GeneratedCode, runtime: Mapping[str, str]
) -> dict[str, str]:
    """Return a source tree that `pip wheel` makes one wheel per machine of, for all Pythons."""
    package = f"{code.prefix}_drift"
    given = [_describe(c, n) for c, n in zip(model.channels, name_channels(model), strict=True)]
    environment = make_environment()
    environment.policies["json.dumps_kwargs"] = {"ensure_ascii": False}
    every = {code.header_name: code.header, code.source_name: code.source, **runtime}
    arguments = [
        f"{g.argument}: float{' | None' if g.no_reading is not None else ''}" for g in given
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
        "example": ", ".join(f"{g.argument}=..." for g in given),
        "encoded": ", ".join(f"CHANNELS[{i}].encode({g.argument})" for i, g in enumerate(given)),
    }
    sources = [*sorted(f"src/{n}" for n in every if n.endswith(".c")), "src/python_module.c"]
    oldest = ".".join(map(str, OLDEST_PYTHON))
    tag = "cp" + "".join(map(str, OLDEST_PYTHON))
    return {f"src/{name}": text for name, text in every.items()} | {
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
    sources={sources},
    include_dirs=["src"],
    py_limited_api=True,
)
setup(ext_modules=[library], options={{"bdist_wheel": {{"py_limited_api": "{tag}"}}}})
""",
    }


def _describe(channel: Channel, field: str) -> _Given:
    argument = f"{field}_" if keyword.iskeyword(field) or field in _TAKEN else field
    by = channel.conversion
    in_unit = by is None or by.is_plain
    return _Given(
        name=channel.name,
        field=field,
        argument=argument,
        unit=channel.unit if in_unit else "code",
        lsb=channel.lsb if in_unit else 1.0,
        offset=channel.offset if in_unit else 0.0,
        least=channel.raw_least,
        most=channel.raw_most,
        no_reading=channel.raw_lacks[0] if channel.raw_lacks else None,
        type=channel.raw_type,
    )
