"""`zerodrift export`: the trained compensator as float ONNX, integer model and golden vectors."""

from pathlib import Path

import click

from zerodrift.commands.common import (
    directory_option,
    json_option,
    print_json,
    print_notes,
    skip_invalid_option,
)


@click.command()
@directory_option
@json_option
@skip_invalid_option
def command(directory: Path, as_json: bool, skip_invalid: bool) -> None:
    """Write build/network.onnx (float), model.json and integer.onnx (integer) and golden.npz.

    The integer model is proven free of overflow for every input, or refused with the reason.
    """
    from rich.console import Console

    from zerodrift.commands.project import open_project, train_project
    from zerodrift.export.compose import compose_integer_model, encode_inputs
    from zerodrift.export.golden import compute_golden
    from zerodrift.export.integer_onnx import save_integer_onnx

    console = Console(stderr=True)
    config, dataset = open_project(directory, skip_invalid)
    print_notes(dataset.notes)
    compensator = train_project(config, dataset, console)
    with console.status("quantizing"):
        model = compose_integer_model(compensator, config, dataset)
        run = (dataset.test or dataset.train)[0]
        golden = compute_golden(model, encode_inputs(model, run)[:2000])
    build = config.build_directory
    model.save(build / "model.json")
    save_integer_onnx(model, build / "integer.onnx")
    golden.save(build / "golden.npz")
    files = ["build/network.onnx"] if compensator.network is not None else []
    files += [
        "build/compensator.json",
        "build/model.json",
        "build/integer.onnx",
        "build/golden.npz",
    ]
    bounds = model.prove()
    if as_json:
        print_json({"model_hash": model.hash, "bounds_proven": len(bounds), "files": files})
        return
    click.echo(f"model {model.hash[:12]}: {len(bounds)} bounds proven for every input")
    click.echo("wrote " + ", ".join(files))
