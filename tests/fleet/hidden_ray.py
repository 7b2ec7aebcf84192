"""Ray as a fleet sees it, whose workers see nothing of the driver's project."""

from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import cloudpickle


class RayError(Exception):
    """What Ray raises when its cluster is lost."""


class HiddenRay:
    """Runs a task in this process while the driver's folders are away; all else is pickled."""

    exceptions = SimpleNamespace(RayError=RayError)

    def __init__(self, *hidden: Path, spoil=lambda parcel: parcel) -> None:
        self.hidden, self.spoil = hidden, spoil
        self.ran = 0

    def init(self, **_):
        pass

    def shutdown(self):
        pass

    def cluster_resources(self):
        return {"CPU": 1.0}

    def remote(self, **_):
        return lambda function: SimpleNamespace(
            remote=lambda *arguments: cloudpickle.dumps((function, arguments))
        )

    def wait(self, pending, num_returns):
        return pending[:num_returns], pending[num_returns:]

    def get(self, task):
        self.ran += 1
        function, (parcel,) = cloudpickle.loads(task)
        with self.hide():
            answer = cloudpickle.dumps(function(self.spoil(parcel)))
        return cloudpickle.loads(answer)

    @contextmanager
    def hide(self):
        away = [path.with_name(f"{path.name}_away") for path in self.hidden]
        for path, other in zip(self.hidden, away, strict=True):
            path.rename(other)
        try:
            yield
            assert not any(path.exists() for path in self.hidden), "a worker wrote there"
        finally:
            for path, other in zip(self.hidden, away, strict=True):
                other.rename(path)
