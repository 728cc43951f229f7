"""Readers meet damaged files: only JaxMocapError may leave them, in bounded time and memory.

Runs 60 mutants for each reader, or JAXMOCAP_MUTANTS. The mutants of a reader are read in one process of its own
with a limit on memory and a watchdog on time, so that a crash or a forged size is a failed test and not the end of
the test run.
"""

import json
import os
import random
import struct
import subprocess
import sys
from pathlib import Path

import pytest

MUTANTS = int(os.environ.get("JAXMOCAP_MUTANTS", "60"))
SECONDS_EACH = 5
MEMORY_GIB = 2  # on top of what is mapped when the imports are done

TOML = """\
[cam_left]
name = "left"
size = [640, 480]
matrix = [[800.0, 0.0, 320.0], [0.0, 810.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [0.1, -0.2, 0.001, 0.002, 0.05]
rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
translation = [1.0, 2.0, 3.0]

[cameras.1]
size = [640, 480]
matrix = [[800, 0, 320], [0, 810, 240], [0, 0, 1]]
distortions = [0, 0, 0, 0]
rotation = [0.1, 0.2, 0.3]
translation = [1, 2, 3]
fisheye = false

[metadata]
schema = 1
unit = "mm"
up = "-y"
error = 0.25
seed = 3
adjusted = false
[metadata.sigmas.left]
fx = 0.5
[metadata.inputs]
"left 01.jpg" = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
"""
MATRIX = "   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {data} ]\n"
YAML = (
    '%YAML:1.0\n---\nimage_size: [ 640, 480 ]\ncamera_name: "left"\n'
    + "M1: !!opencv-matrix\n" + MATRIX.format(rows=3, cols=3, data="800., 0., 320., 0., 810.,\n   240., 0., 0., 1.")
    + "D1: !!opencv-matrix\n" + MATRIX.format(rows=1, cols=5, data="1.0e-01, -0.2, 0., 0., 0.")
    + "M2: !!opencv-matrix\n" + MATRIX.format(rows=3, cols=3, data="800., 0., 320., 0., 810., 240., 0., 0., 1.")
    + "D2: !!opencv-matrix\n" + MATRIX.format(rows=5, cols=1, data="1.0e-01, -0.2, 0., 0., 0.")
    + "R: !!opencv-matrix\n" + MATRIX.format(rows=3, cols=3, data="1., 0., 0., 0., 1., 0., 0., 0., 1.")
    + "T: !!opencv-matrix\n" + MATRIX.format(rows=3, cols=1, data="-60., .5, 0.")
)  # fmt: skip
TURNTABLE = """\
rotation = [3.0, 0.0, 0.0]
distance = 400.0
height = 80.0
covariance = [[1e-6, 0, 0, 1e-5], [0, 1e-6, 0, 0], [0, 0, 1e-6, 0], [1e-5, 0, 0, 0.04]]
[axis]
point = [0.0, 56.44800322394687, 395.99699864017817]
direction = [0.0, -0.9899924966004454, 0.1411200080598672]
[angles_deg]
"a_000.jpg" = 0
"a_030.jpg" = 30.25
[sigma_angles_deg]
"a_030.jpg" = 0.07
[metadata]
schema = 1
unit = "mm"
error = 0.25
held = ["height", "zero angle"]
[metadata.inputs]
"a_000.jpg" = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
"""
COLOURS = """\
[colours]
"head.1" = { h = 0.499, s = 0.176, b = 0.754, sd = [0.02, 0.03, 0.1], n = 7 }
head.2 = { h = 0.303, s = 0.611, b = 0.607 }
"arm.L1" = { h = 0.5, s = 0.2, b = 0.8, n = 3, covariance = [0.001, 0.0, 0.001, 0.0, 0.0002, 0.01] }
[metadata]
schema = 1
[metadata.inputs]
"tpose_000.jpg" = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
"""
PUPPET = """\
schema = 1
unit = "mm"
distance = 400.0
height = 80.0
inputs = ["camera", "colours"]
[photos]
0 = "a_000.jpg"
"-12.5" = "b \\u00e4.png"
"""
IDENTIFIED = """{
 "inputs": {"a_000.jpg": "e3b0"}, "warnings": ["one"], "stated_deg": {"a_000.jpg": 0.0},
 "detections": {"a_000.jpg": {"head.1": [310.25, 200.5], "arm.L1": [1e2, 7]}},
 "sigma_px": {"a_000.jpg": {"head.1": 0.1, "arm.L1": 0.2}}, "radius_px": {"a_000.jpg": {"head.1": 6.5, "arm.L1": 7}},
 "rejected": {"a_000.jpg": [[3.5, 4.5]]}, "unsure": {"a_000.jpg": 1}
}
"""


def _glb() -> bytes:
    """Two joints, one of which turns, and a ball; as small as can be, so that mutants meet what is read."""
    document = {
        "asset": {"version": "2.0", "extras": {"fps": 25, "source_unit": "mm"}},
        "nodes": [
            {"name": "root", "children": [1], "translation": [1, 2, 3], "rotation": [0, 0, 0, 1]},
            {"name": "arm", "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 2, 0, 1]},
            {"name": "ball", "mesh": 0, "scale": [1, 1, 1]},
        ],
        "skins": [{"joints": [0, 1]}],
        "meshes": [{"primitives": [{"material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [1, 0.5, 0, 1]}}],
        "animations": [
            {
                "channels": [{"sampler": 0, "target": {"node": 0, "path": "rotation"}}],
                "samplers": [{"input": 0, "output": 1, "interpolation": "LINEAR"}],
            }
        ],
        "buffers": [{"byteLength": 40}],
        "bufferViews": [{"buffer": 0, "byteLength": 8}, {"buffer": 0, "byteOffset": 8, "byteLength": 32}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 2, "type": "SCALAR"},
            {"bufferView": 1, "componentType": 5126, "count": 2, "type": "VEC4"},
        ],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    blob = struct.pack("<10f", 0, 1, 0, 0, 0, 1, 0, 0, 1, 0)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


SEEDS: dict[str, str | bytes] = {
    "puppet_folder.read_index": PUPPET,
    "read_beads": IDENTIFIED,
    "read_glb": _glb(),
    "read_colours": COLOURS,
    "read_rig": TOML,
    "read_turntable": TURNTABLE,
    "read_opencv_yaml": YAML,
    "read_correspondences": "view,x,y,z,u,v,sigma,camera\n" + "1,0.5,1e-3,-2,10.25,20.5,0.1,left\n" * 8,
    "read_observations": "frame,camera,marker,u,v,sigma\n" + '3,"cam 1",,10.25,20.5,0.1\n' * 8,
    "read_bones": 'unit = "mm"\n[lengths]\nl-elbow-joint = 33.5\nr-elbow-joint = 33\nhead-joint = 1e1\n',
    "read_points": "frame,marker,x,y,z,sigma_x,sigma_y,sigma_z,views\n"
    + "".join(f'{i},"head.1",10.25,-20.5,1e-3,0.1,,0.3,12\n' for i in range(8)),
}
NASTY = [
    b"nan", b"inf", b"-", b"1e999", b"9" * 5000, b"0x" + b"f" * 5000, b"[" * 3000, b'"', b"\\u0000", b"\0", b"\xff\xfe",
    b"\xc3", b"\r", b"\n\n", b",,", b";", b"=", b"[metadata]\n", b"1000000", b"true", b"[]", b"{}", b"!!opencv-matrix",
    b"# ", b".Inf", b"- ", b": ", b"1979-05-27T07:32:00Z", b"\xf0\x9f\x98\x80", b"'''", b"matrix = 3\n",
]  # fmt: skip

_WORKER = f"""
import operator, resource, signal, sys
from pathlib import Path
import jax
jax.config.update("jax_enable_x64", True)
import jaxmocap.io as io
import jaxmocap.io.puppet_folder
from jaxmocap._errors import InputError, JaxMocapError
from jaxmocap.workflows import puppet_words
def read_beads(path):  # what is damaged is None there: it is found anew
    if puppet_words.read_beads(Path(path), {{"a_000.jpg": 0.0}}, {{"a_000.jpg": "e3b0"}}) is None:
        raise InputError(path)
reader = read_beads if sys.argv[1] == "read_beads" else operator.attrgetter(sys.argv[1])(io)
reader(sys.argv[2])  # the undamaged file: compiles what is compiled, and must be read
pages = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (pages + {MEMORY_GIB} * 2**30,) * 2)
for path in sys.argv[3:]:
    print(path, flush=True)
    signal.alarm({SECONDS_EACH})
    try:
        reader(path)
        print("read")
    except JaxMocapError as error:
        assert path in str(error) and len(str(error)) < 1500, str(error)[:500]
        print("refused")
"""


def _mutant(seed: bytes, rng: random.Random) -> bytes:
    data = bytearray(seed)
    for _ in range(rng.choice([1, 1, 2, 5])):
        at = rng.randrange(len(data) + 1)
        to = min(len(data), at + rng.choice([1, 2, 8, 40]))
        kind = rng.randrange(6)
        if kind == 0:
            data[at:to] = b""
        elif kind == 1:
            data[at:at] = rng.choice(NASTY)
        elif kind == 2:
            data[at:to] = rng.choice(NASTY)
        elif kind == 3:
            data[at:to] = bytes(rng.randrange(256) for _ in range(to - at))
        elif kind == 4:
            data[at:at] = data[rng.randrange(len(data) + 1) :][:60]
        else:
            del data[at:]
    return bytes(data)


@pytest.mark.parametrize("reader", SEEDS)
def test_only_our_errors_leave_a_reader(tmp_path, reader):
    rng = random.Random(f"jaxmocap {reader}")
    seed = SEEDS[reader] if isinstance(SEEDS[reader], bytes) else SEEDS[reader].encode()
    whole = tmp_path / "whole"
    whole.write_bytes(seed)
    paths = []
    for i in range(MUTANTS):
        paths.append(tmp_path / f"mutant{i}")
        paths[-1].write_bytes(_mutant(seed, rng))
    process = subprocess.run(
        [sys.executable, "-W", "error", "-c", _WORKER, reader, str(whole), *map(str, paths)],
        capture_output=True, text=True, timeout=120, cwd=Path(__file__).parents[2], check=False,
    )  # fmt: skip
    lines = process.stdout.split()
    last = next((line for line in reversed(lines) if "mutant" in line), "none")
    damaged = Path(last).read_bytes()[:2000] if last != "none" else b""
    assert process.returncode == 0, f"{last}: status {process.returncode}\n{process.stderr[-2000:]}\n{damaged!r}"
    assert lines.count("read") + lines.count("refused") == MUTANTS
    assert lines.count("refused") >= MUTANTS // 4  # else the mutants are too tame to show anything
