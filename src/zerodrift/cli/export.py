"""`zerodrift export`: the trained compensator as float ONNX, integer model and golden vectors."""

from pathlib import Path

import click

from zerodrift.cli.common import (
    changes_project,
    directory_option,
    json_option,
    print_notes,
    print_result,
    sensor_option,
    skip_invalid_option,
)


@click.command()
@directory_option
@sensor_option
@json_option
@skip_invalid_option
@click.option("--force", is_flag=True, help="Export from logs in which wrong data are found.")
@changes_project
def command(
    directory: Path, sensor: str | None, as_json: bool, skip_invalid: bool, force: bool
) -> None:
    """Write build/: network.onnx (float), model.json, integer.onnx, golden.npz, certificate.json.

    The integer model is proven free of overflow for every input, or refused with the reason.
    Logs that hold wrong data stop it before anything is fitted: exit code 1.
    """
    from zerodrift.base.journal import write_all
    from zerodrift.base.terminal import open_terminal
    from zerodrift.cli.firmware import show_path
    from zerodrift.codegen.generate import generate
    from zerodrift.export.compose import (
        compose_quantized,
        describe_compensator,
        encode_inputs,
    )
    from zerodrift.export.error_bound import bound_errors
    from zerodrift.export.fine_tune import load_or_tune
    from zerodrift.export.golden import compute_golden
    from zerodrift.export.integer_onnx import build_integer_onnx
    from zerodrift.report.results import ExportResult
    from zerodrift.tasks.project import open_project, refuse_wrong_data, train_project
    from zerodrift.verify.certificate import certify
    from zerodrift.verify.vectors import draw_golden

    console = open_terminal(stderr=True)
    config, dataset = open_project(directory, skip_invalid, sensor)
    print_notes(dataset.notes)
    against = refuse_wrong_data(config, dataset, force=force, as_json=as_json)
    print_notes(tuple(statement.text for statement in against))
    compensator = train_project(config, dataset, console)
    with console.status("quantizing"):
        described = describe_compensator(compensator, config, dataset.train)
        tuned = load_or_tune(described, config, dataset.train)
        quantized = compose_quantized(tuned, config, dataset)
        model = quantized.model
        run = (dataset.test or dataset.train)[0]
        golden = compute_golden(model, draw_golden(model, encode_inputs(model, run)))
    build = config.build_directory
    certificate = certify(model, generate(model), bound_errors(quantized))
    contents = {
        build / "model.json": model.to_text().encode(),
        build / "integer.onnx": build_integer_onnx(model),
        build / "golden.npz": golden.to_bytes(),
        build / "certificate.json": certificate.encode(),
    }
    write_all(config.directory, contents)
    names = ["network.onnx"] if compensator.network is not None else []
    names += ["compensator.json", *(path.name for path in contents)]
    files = [show_path(build / name, config.directory) for name in names]
    bounds = model.prove()
    if as_json:
        print_result(ExportResult(model.hash, len(bounds), tuple(files)))
        return
    click.echo(f"model {model.hash[:12]}: {len(bounds)} bounds proven for every input")
    click.echo("wrote " + ", ".join(files))
