"""Parts of zerodrift that need packages which a plain install leaves out."""

import re
import shlex
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires
from importlib.util import find_spec

from zerodrift.base.errors import InputError


@dataclass(frozen=True)
class Extra:
    """A set of packages that pyproject.toml lists as optional; `tell_install` installs it."""

    name: str
    package: str
    """The module that is looked for."""
    title: str


TRAIN = Extra("train", "torch", "PyTorch")
PAGE = Extra("page", "dash", "Dash")
FLEET = Extra("fleet", "ray", "Ray")
FLEET_URL = Extra("fleet", "fsspec", "fsspec")
RECORD_SERIAL = Extra("record", "serial", "pySerial")
RECORD_CAN = Extra("record", "can", "python-can")
RECORD_DBC = Extra("record", "cantools", "cantools")
RECORD_MCAP = (
    Extra("formats", "mcap", "the MCAP library"),
    Extra("formats", "mcap_ros2", "the MCAP library's ROS 2 support"),
)
RECORD_MQTT = Extra("record", "paho.mqtt", "Eclipse Paho")


def is_there(package: str) -> bool:
    """Tell whether a package is installed, without loading it."""
    try:
        return find_spec(package) is not None
    except (ImportError, ValueError):
        return False


def require(extra: Extra, what: str) -> None:
    """Raise where an extra is not installed.

    Args:
        extra: what is needed.
        what: what needs it, in the user's terms.

    Raises:
        InputError: it is not installed; says how to install it.
    """
    if not is_there(extra.package):
        raise InputError(
            f"{what}: needs {extra.title}, which is not installed; expected the extra "
            f"'{extra.name}'. Run: {tell_install(extra.name)}"
        )


def tell_install(extra: str) -> str:
    """Return the command that installs an extra, however zerodrift itself was installed.

    It names the packages, as the metadata of the installation do: zerodrift is on no index, and its
    checkout may be gone.
    """
    try:
        listed = requires("zerodrift") or []
    except PackageNotFoundError:
        listed = []
    own = re.compile(rf"extra == ['\"]{re.escape(extra)}['\"]")
    packages = [each.partition(";")[0].strip() for each in listed if own.search(each)]
    if not packages:
        return f"pip install '.[{extra}]', in zerodrift's checkout"
    return f"pip install {' '.join(shlex.quote(package) for package in packages)}"
