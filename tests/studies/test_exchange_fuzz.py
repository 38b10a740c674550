"""Readers of files that others wrote: whatever is in them, a result or one sentence, soon, and in little memory.

What a file may hold is made of the words of its format, of mutations of a good file, and of bytes. The thorough tier
takes seconds; `-m slow` spends half an hour, or DIFFSHADE_FUZZ_SECONDS.
"""

import os
import time
import tomllib
import tracemalloc

import pytest
import tomli_w
from hostile import SCENE, TEXTS, check_reading, glb, good_texts, of_strangers, watch_opening
from hypothesis import given
from hypothesis import strategies as st

import diffshade as ds

MULTIPLE, CONSTANT = 64, 2**20  # memory: so many times the file, and what any call takes
WORDS = {
    ".mtl": "newmtl a b Ka Kd Ks Ke Ns Ni d Tr Tf illum -halo map_Kd spectral xyz ../../../etc/passwd /dev/zero # \\\n",
    ".json": '{ } [ ] : , "type" "MeshPhongMaterial" "color" "specular" "shininess" "opacity" null true 16777215',
    ".gltf": '{ } [ ] : , "asset" "version" "2.0" "materials" "name" "extensions" "pbrMetallicRoughness" null true 1e9',
    ".glb": 'glTF \x02\0\0\0 \x14\0\0\0 JSON BIN\0 {"asset":{"version":"2.0"},"materials":[{}]} { } [ ]',
    ".ies": "IESNA:LM-63-2002 TILT=NONE TILT=INCLUDE TILT=../x [TEST] 90 180 360 13 37",
    ".ldt": "LED 2 4 6 360 180 16 \r",
    ".toml": '[camera] [[objects]] [[lights]] type = "SpotLight" surface = "Sphere" material { } , k_d eye cutoff',
}
NUMERALS = "0 1 -1 2 0.5 1e9 1e999 -1e-999 nan inf 1_0 0x10 ٣ 99999999999999999999 .5 5. + - e5 " + "9" * 5000
EXAMPLES = {".json": 40, ".gltf": 25, ".glb": 25, ".toml": 120}


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A file of each format that is read."""
    return good_texts(tmp_path_factory.mktemp("good"))


def contents(suffix, base):
    words = st.sampled_from([*WORDS[suffix].split(" "), *NUMERALS.split(" "), "\n", "\n"]) | st.text(max_size=5)
    of_words = st.lists(words, max_size=60).map(lambda parts: " ".join(parts).encode("utf-8", "replace"))
    place = st.integers(0, len(base))
    piece = st.binary(max_size=8) | st.sampled_from([n.encode() for n in NUMERALS.split(" ")])

    @st.composite
    def mutated(draw):
        data = base
        for _ in range(draw(st.integers(1, 4))):
            a, b = sorted((draw(place), draw(place)))
            b = min(b, a + draw(st.sampled_from([0, 1, 3, 40, 10_000])))
            data = data[:a] + draw(piece) * draw(st.sampled_from([1, 1, 1, 200])) + data[b:]
        return data

    ways = [mutated(), of_words, st.binary(max_size=200)]
    return st.one_of(*ways, *[edited()] * 3) if suffix == ".toml" else st.one_of(*ways)


def edited():
    """A scene file of which some values are others: TOML still, but no longer a scene."""
    plain = (st.integers(), st.floats(), st.booleans(), st.text(max_size=5), st.dates())
    keys = st.sampled_from(["type", "k_d", "position", "vertical", "lobe", "x"])
    value = st.recursive(st.one_of(plain), lambda of: st.lists(of, max_size=3) | st.dictionaries(keys, of, max_size=3))

    @st.composite
    def of_scene(draw):
        scene = tomllib.loads(SCENE)
        for _ in range(draw(st.integers(1, 3))):
            place = scene
            while True:
                items = list(place.items() if isinstance(place, dict) else enumerate(place))
                if not items:
                    break
                key, inner = draw(st.sampled_from(items))
                if not isinstance(inner, dict | list) or draw(st.booleans()):
                    place[key] = draw(value)
                    break
                place = inner
        return tomli_w.dumps(scene).encode("utf-8", "replace")

    return of_scene()


def fuzz(suffix, base, folder, examples, *, start=0):
    path = folder / f"fuzz{suffix}"

    @of_strangers(examples, start)
    @given(contents(suffix, base))
    def run(data):
        check_reading(TEXTS[suffix], path, data)

    run()


@pytest.mark.parametrize("suffix", TEXTS)
def test_any_file_gives_a_result_or_one_sentence(suffix, good, tmp_path):
    check_reading(TEXTS[suffix], tmp_path / f"good{suffix}", good[suffix])
    fuzz(suffix, good[suffix], tmp_path, EXAMPLES.get(suffix, 80))


@pytest.mark.slow
def test_any_file_for_half_an_hour(good, tmp_path):
    end, rounds = time.monotonic() + float(os.environ.get("DIFFSHADE_FUZZ_SECONDS", "1800")), 0
    while time.monotonic() < end:
        rounds += 1
        for suffix in TEXTS:
            fuzz(suffix, good[suffix], tmp_path, 500, start=rounds)
    print(f"{500 * rounds} files of each of {len(TEXTS)} formats")


LARGE = {
    ".mtl": lambda n: b"newmtl a\n" + b"Kd 1 1 1 # x\n" * n,
    ".json": lambda n: b'{"type": "MeshPhongMaterial", "a": ' + b"[" * n,
    ".gltf": lambda n: b'{"asset": {"version": "2.0"}, "materials": [{"a": 1}], "b": ' + b"[" * n,
    ".glb": lambda n: glb(b'{"asset": {"version": "2.0"}, "materials": [{"a": 1}], "b": ' + b"[" * n),
    ".ies": lambda n: b"TILT=NONE\n1 1 1 2 1 1 1 0 0 0 1 1 1\n" + b"1 " * n,
    ".ldt": lambda n: b"0\n" * n,
    ".toml": lambda n: b"a = [" + b"1, " * n + b"]",
}


DEEP = {
    ".gltf": b'{"materials":[' * 100_000,
    ".glb": glb(b'{"materials":[' * 100_000),
    ".json": b'{"type":' * 100_000,
    ".toml": b"a = " + b"[" * 100_000,
    ".ies": b"TILT=NONE\n" * 100_000,
}


@pytest.mark.parametrize("suffix", DEEP)
def test_a_file_that_is_made_to_hang_does_not(suffix, tmp_path):
    check_reading(TEXTS[suffix], tmp_path / f"deep{suffix}", DEEP[suffix])


@pytest.mark.parametrize("suffix", TEXTS)
def test_memory_is_a_multiple_of_the_file(suffix, tmp_path, good):
    path = tmp_path / f"large{suffix}"
    path.write_bytes(good[suffix])
    check_reading(TEXTS[suffix], path, good[suffix])  # imports and caches are no part of it
    data = LARGE[suffix](20_000)
    tracemalloc.start()
    try:
        check_reading(TEXTS[suffix], path, data)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak <= MULTIPLE * len(data) + CONSTANT


def test_maps_are_never_opened(tmp_path, monkeypatch):
    """Neither within the file's folder nor outside of it, whatever their names say."""
    names = (
        "../secret.png",
        "/etc/passwd",
        "secret.png",
        "~/secret",
        "\\\\host\\share",
        "file:///etc/passwd",
        "-o ../x",
    )
    lines = [f"{key} {name}" for key in ("map_Kd", "map_Bump", "bump", "refl", "disp", "decal") for name in names]
    (tmp_path / "a.mtl").write_text("newmtl ../../a\nKd 1 0 0\n" + "\n".join(lines))
    opened = watch_opening(monkeypatch)
    found = ds.exchange.read_materials(tmp_path / "a.mtl")
    assert list(found) == ["../../a"]
    assert set(opened) == {str(tmp_path / "a.mtl")}
