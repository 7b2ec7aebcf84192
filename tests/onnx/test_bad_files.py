"""Files that are damaged or meant to harm: refused with the reason, nothing read or written."""

import json
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from tests.golden.model_factory import Shape, draw_model
from tests.onnx.graphs import Graph

from zerodrift.base.errors import InputError, ZerodriftError
from zerodrift.codegen.generate import generate
from zerodrift.export.integer_model import canonical_json
from zerodrift.export.model_files import load_model
from zerodrift.export.onnx_reader import LARGEST_FILE, read_imported, read_imported_bytes


def build_network(nan: bool = False) -> onnx.ModelProto:
    g, rng = Graph(), np.random.default_rng(1)
    y, _ = g.gru("x", rng, 3, 4)
    kernel = rng.normal(size=(4, 1))
    kernel[2, 0] = np.nan if nan else kernel[2, 0]
    return onnx.load_model_from_string(
        g.build({"x": ("T", "B", 3)}, [g.op("MatMul", y, g.constant(kernel))])
    )


def refuse(path: Path, told: str) -> None:
    """Read a file that must be refused, and look that nothing appeared beside it."""
    before = sorted(p.name for p in path.parent.iterdir())
    with pytest.raises(InputError, match=told) as caught:
        read_imported(path)
    assert str(path) in str(caught.value)
    assert sorted(p.name for p in path.parent.iterdir()) == before


@pytest.mark.parametrize("keep", [0.0, 0.2, 0.7, 0.99])
def test_truncated_network_is_refused(keep: float, tmp_path: Path) -> None:
    content = build_network().SerializeToString()
    path = tmp_path / "net.onnx"
    path.write_bytes(content[: int(len(content) * keep)])
    refuse(path, "net.onnx")


@pytest.mark.parametrize(
    "content",
    [b"\x80\x04K\x01.", b"{}", b"PK\x03\x04", bytes(range(256)) * 40],
    ids=["pickle", "json", "zip", "noise"],
)
def test_file_that_is_no_network_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "net.onnx"
    path.write_bytes(content)
    refuse(path, "net.onnx")


def test_missing_network_is_refused(tmp_path: Path) -> None:
    refuse(tmp_path / "gone.onnx", "cannot be read")


def test_damaged_bytes_never_raise_anything_else(tmp_path: Path) -> None:
    """A byte changed anywhere gives a network or a message, never another error."""
    content = bytearray(build_network().SerializeToString())
    rng, path = np.random.default_rng(2), tmp_path / "net.onnx"
    outcomes = {"read": 0, "refused": 0}
    for _ in range(150):
        damaged = bytearray(content)
        for at in rng.integers(0, len(content), 3):
            damaged[at] = rng.integers(0, 256)
        path.write_bytes(damaged)
        try:
            read_imported(path)
            outcomes["read"] += 1
        except InputError:
            outcomes["refused"] += 1
    assert min(outcomes.values()) > 0


@pytest.mark.parametrize(
    ("location", "told"),
    [
        ("weights.bin", "which cannot be read"),
        ("../../etc/passwd", "a file in its own folder"),
        ("/etc/passwd", "a file in its own folder"),
        ("link.bin", "a file in its own folder"),
        ("", "a file in its own folder"),
    ],
)
def test_external_data_elsewhere_is_not_followed(location: str, told: str, tmp_path: Path) -> None:
    model = build_network()
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value=location)
    (tmp_path / "link.bin").symlink_to("/etc/passwd")
    (tmp_path / "net.onnx").write_bytes(model.SerializeToString())
    refuse(tmp_path / "net.onnx", told)


def test_external_data_beside_the_file_is_read(tmp_path: Path) -> None:
    """As the plain torch.onnx.export writes it: net.onnx and net.onnx.data."""
    path, model = tmp_path / "net.onnx", build_network()
    inside = read_imported_bytes(model.SerializeToString(), "net.onnx").network
    onnx.save(model, path, save_as_external_data=True, location="net.onnx.data", size_threshold=0)
    found = read_imported(path).network
    np.testing.assert_array_equal(found.grus[0].w_h, inside.grus[0].w_h)
    np.testing.assert_array_equal(found.head, inside.head)
    whole = (tmp_path / "net.onnx.data").read_bytes()
    (tmp_path / "net.onnx.data").write_bytes(whole[:40])
    refuse(path, "cannot be read from 'net.onnx.data'")
    (tmp_path / "net.onnx.data").unlink()
    refuse(path, "external_data=False")


def test_external_data_inside_a_node_is_not_followed(tmp_path: Path) -> None:
    model = build_network()
    tensor = numpy_helper.from_array(np.zeros(3, dtype=np.float32), "t")
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="/etc/passwd")
    node = helper.make_node("Constant", [], ["unused"], value=tensor)
    model.graph.node.insert(0, node)
    (tmp_path / "net.onnx").write_bytes(model.SerializeToString())
    refuse(tmp_path / "net.onnx", "a file in its own folder")


def test_cycle_is_refused(tmp_path: Path) -> None:
    model = build_network()
    answer = model.graph.node[-1].output[0]
    model.graph.node.insert(0, helper.make_node("Add", [answer, "x"], ["loop"], name="loop"))
    model.graph.node[1].input[0] = "loop"
    (tmp_path / "net.onnx").write_bytes(model.SerializeToString())
    refuse(tmp_path / "net.onnx", "no valid ONNX graph")


@pytest.mark.parametrize("dims", [[1, 30_000, 100_000], [2**40], [2**62, 2**62]])
def test_tensor_that_claims_gigabytes_is_refused(dims: list[int], tmp_path: Path) -> None:
    model = build_network()
    del model.graph.initializer[0].dims[:]
    model.graph.initializer[0].dims.extend(dims)
    (tmp_path / "net.onnx").write_bytes(model.SerializeToString())
    refuse(tmp_path / "net.onnx", "net.onnx")


@pytest.mark.parametrize("op", ["ConstantOfShape", "Expand", "Tile", "outer product", "MatMul"])
def test_graph_that_would_fill_the_memory_is_refused(op: str, tmp_path: Path) -> None:
    """10 GB by a few bytes: never computed, since nothing that the answer needs is that large."""
    g, rng = Graph(), np.random.default_rng(1)
    y, _ = g.gru("x", rng, 3, 4)
    sizes = g.constant([50_000, 50_000], np.int64)
    wide = g.constant(np.ones((1, 50_000)))
    tall = g.op("Transpose", wide)
    huge = {
        "ConstantOfShape": lambda: g.op("ConstantOfShape", sizes),
        "Expand": lambda: g.op("Expand", g.constant(np.arange(50_000.0)), sizes),
        "Tile": lambda: g.op("Tile", wide, sizes),
        "outer product": lambda: g.op("Mul", wide, tall),
        "MatMul": lambda: g.op("MatMul", tall, wide),
    }[op]()
    answer = g.op("MatMul", y, huge)
    path = tmp_path / "net.onnx"
    path.write_bytes(g.build({"x": ("T", "B", 3)}, [answer]))
    refuse(path, "net.onnx")


def nest_functions(levels: int, loop: bool = False) -> onnx.ModelProto:
    """Return a graph of functions that each call the next one twice."""
    model = build_network()
    opsets = [helper.make_opsetid("", 17), helper.make_opsetid("own", 1)]
    for level in range(levels):
        following = f"f{level + 1}" if level + 1 < levels else "f0" if loop else "Identity"
        domain = "own" if following != "Identity" else ""
        nodes = [
            helper.make_node(following, ["x"], ["t"], domain=domain),
            helper.make_node(following, ["t"], ["y"], domain=domain),
        ]
        function = helper.make_function("own", f"f{level}", ["x"], ["y"], nodes, opsets)
        model.functions.append(function)
    model.opset_import.append(helper.make_opsetid("own", 1))
    model.graph.node.insert(0, helper.make_node("f0", ["x"], ["called"], domain="own"))
    model.graph.node[1].input[0] = "called"
    return model


def test_functions_are_unfolded_within_limits(tmp_path: Path) -> None:
    path = tmp_path / "net.onnx"
    path.write_bytes(nest_functions(3).SerializeToString())
    assert read_imported(path).network.head.shape == (1, 4)
    path.write_bytes(nest_functions(20).SerializeToString())
    refuse(path, "unfold to")
    path.write_bytes(nest_functions(3, loop=True).SerializeToString())
    refuse(path, "no valid ONNX graph")


def test_huge_file_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "net.onnx"
    with path.open("wb") as file:
        file.truncate(LARGEST_FILE + 1)  # sparse: takes no room on the disk
    refuse(path, "expected at most 64 MiB")


def test_huge_layer_is_refused(tmp_path: Path) -> None:
    g, rng = Graph(), np.random.default_rng(1)
    y, _ = g.gru("x", rng, 3, 300)
    path = tmp_path / "net.onnx"
    path.write_bytes(g.build({"x": ("T", "B", 3)}, [y]))
    refuse(path, "300 units")


def test_weight_that_is_not_a_number_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "net.onnx"
    path.write_bytes(build_network(nan=True).SerializeToString())
    refuse(path, r"MatMul .*has the value nan at \[2, 0\]")


def test_old_opset_is_refused(tmp_path: Path) -> None:
    model = build_network()
    model.opset_import[0].version = 6
    path = tmp_path / "net.onnx"
    path.write_bytes(model.SerializeToString())
    refuse(path, "opset 6|no valid ONNX")


def rewrite(path: Path, change: object) -> None:
    """Edit a model file and give it the hash that belongs to the edited content."""
    import hashlib

    body = json.loads(path.read_text(encoding="utf-8"))
    body.pop("hash")
    change(body)  # type: ignore[operator]
    notes = body.pop("notes")
    digest = hashlib.sha256(canonical_json(body).encode()).hexdigest()
    path.write_text(canonical_json({**body, "notes": notes, "hash": digest}), encoding="utf-8")


def find_node(body: dict, kind: str) -> dict:
    return next(node for node in body["nodes"] if node["kind"] == kind)


FORGERIES = {
    "a shift beyond the width": lambda b: find_node(b, "product").update(shift=70),
    "a negative shift": lambda b: find_node(b, "product").update(shift=-1),
    "a shift of a gate": lambda b: find_node(b, "gru_stack")["gru"].update(shift=[3, 40, 3]),
    "a shift of a dense row": lambda b: find_node(b, "dense").update(shift=[-2, 3, 3]),
    "limits the wrong way": lambda b: find_node(b, "dense").update(low=[9, 9, 9], high=[1, 1, 1]),
    "limits beyond int16": lambda b: find_node(b, "dense").update(high=[99999, 9, 9]),
    "an activation that is none": lambda b: find_node(b, "dense").update(activation="gelu"),
    "too few shifts": lambda b: find_node(b, "dense").update(shift=[3]),
    "weights that overflow": lambda b: find_node(b, "gru_stack")["gru"]["w_h"].update(
        data=[32767] * len(find_node(b, "gru_stack")["gru"]["w_h"]["data"])
    ),
    "a layer of another width": lambda b: find_node(b, "gru_stack")["lower"].append(
        find_node(b, "gru_stack")["gru"]
    ),
    "no lower layer": lambda b: find_node(b, "gru_stack").update(lower=[]),
    "a window of any length": lambda b: find_node(b, "gru_stack").update(window=10**9),
    "a negative window": lambda b: find_node(b, "gru_stack").update(window=-3),
    "a reset of another kind": lambda b: find_node(b, "gru_stack")["gru"].update(reset="x"),
    "a channel that is not there": lambda b: find_node(b, "input").update(channel=9),
    "a text for a number": lambda b: find_node(b, "product").update(shift="3"),
    "a float for a number": lambda b: find_node(b, "product").update(shift=3.5),
    "an input too few": lambda b: find_node(b, "product").update(inputs=["in_0"]),
    "a head of another width": lambda b: find_node(b, "head")["weights"].update(shape=[6, 1]),
}


@pytest.mark.parametrize("forgery", FORGERIES)
def test_forged_model_is_refused_although_its_hash_is_right(forgery: str, tmp_path: Path) -> None:
    """The hash keeps nobody out who can compute one; the proof does."""
    shape = Shape(front_end=("product",), upper=(3,), dense=((3, "relu"),), outputs=2)
    path = tmp_path / "model.json"
    draw_model(shape, 3).save(path)
    rewrite(path, lambda body: None)
    assert load_model(path).prove()
    rewrite(path, FORGERIES[forgery])
    with pytest.raises(ZerodriftError):
        generate(load_model(path))


def test_name_that_is_a_path_stays_in_the_folder(tmp_path: Path) -> None:
    for name in ("../../escape", "/etc/passwd", "a/b", "..", "C:\\x", "con\x00x"):
        code = generate(draw_model(Shape(name=name, hidden=0), 2))
        for file in (code.header_name, code.source_name):
            assert (tmp_path / file).resolve().parent == tmp_path.resolve()
