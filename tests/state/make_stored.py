"""How tests/state/stored was made, once: `python -m tests.state.make_stored FOLDER`.

What is stored there is not made again: it stands for the projects of users, who keep theirs.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from tests.loop.conftest import write_log
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.export.golden import load_golden
from zerodrift.export.model_files import load_model

TOML = """\
# SIMULATED logs: no sensor was measured.
[sensor]
name = "stored"
time = "time_s"
temperature = "temperature_degC"
sample_period_s = 1.0

[outputs.Fz]
measured = "Fz_N"
reference = "ref_Fz_N"
unit = "N"
full_scale = 200

[logs]
train = ["logs/run_[0-2].csv"]
test = ["logs/run_3.csv"]

[[effect]]
kind = "zero_tempco"

[network]
kind = "lag_bank"
"""


def main() -> None:
    """Write logs, add an effect, build the firmware, and save a state of it."""
    folder = Path(sys.argv[1])
    for seed in range(4):
        write_log(folder / "logs" / f"run_{seed}.csv", seed, seconds=300)
    (folder / "zerodrift.toml").write_text(TOML, encoding="utf-8")
    for arguments in (("add", "dark_current", "--force"), ("firmware",), ("verify",)):
        subprocess.run([sys.executable, "-m", "zerodrift", *arguments, "-C", folder], check=True)
    model = load_model(folder / "build" / "model.json")
    golden = load_golden(folder / "build" / "golden.npz")
    with tempfile.TemporaryDirectory() as scratch:
        host = HostModel(model, generate(model), Path(scratch))
        half = len(golden.codes) // 2
        host.run(golden.codes[:half])
        (folder / "saved_state.bin").write_bytes(host.save())
        rest = host.run(golden.codes[half:], restart=False)
    np.savetxt(folder / "drift_after.txt", rest.drift, fmt="%d")


if __name__ == "__main__":
    main()
