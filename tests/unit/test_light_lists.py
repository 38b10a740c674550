"""Lists of lights as domes and people write them: read as they were meant, or refused in a sentence."""

import unicodedata

import numpy as np
import pytest

import diffshade as ds
from diffshade.cli import main
from diffshade.inverse.data.folders import by_name, list_folder
from diffshade.inverse.data.light_lists import numbers_in, read_lp

LIGHTS = np.array([(0.6, 0, 0.8), (0, 0.6, 0.8), (-0.6, 0, 0.8), (0, -0.6, 0.8)])
ROWS = ["0.6 0 0.8", "0 0.6 0.8", "-0.6 0 0.8", "0 -0.6 0.8"]
ONCE = "there is no light_intensities.txt"


def dome(folder, files, names, rows=ROWS, head="{}\n"):
    """Write a folder of photographs, the i-th of level (i + 1)/10, with a list of the lights `names`."""
    for i, file in enumerate(files):
        ds.write_image(folder / file, np.full((4, 5, 3), (i + 1) / 10))
    ds.write_image(folder / "mask.png", np.ones((4, 5, 1)), srgb=False)
    lines = [f"{name} {row}\n" for name, row in zip(names, rows, strict=True)]
    (folder / "dome.lp").write_text(head.format(len(lines)) + "".join(lines), encoding="utf-8")


def read(folder):
    """Return the direction to the light of each photograph, in the order of their levels."""
    scene, views = ds.read_photographs(folder, normals=False)
    level = [float(view.image.mean()) for view in views]
    lights = [light for light in scene.lights if isinstance(light, ds.DirectionalLight)]
    return -np.array([lights[i].direction for i in np.argsort(level)])


NAMES = {
    "two blanks": ([f"shot  {i}.png" for i in range(4)],) * 2,
    "one blank in the list": ([f"shot  {i}.png" for i in range(4)], [f"shot {i}.png" for i in range(4)]),
    "composed accents": (
        [unicodedata.normalize("NFD", f"münze{i}.png") for i in range(4)],
        [unicodedata.normalize("NFC", f"münze{i}.png") for i in range(4)],
    ),
    "another case": ([f"img_{i}.png" for i in range(4)], [f"IMG_{i}.PNG" for i in range(4)]),
    "another suffix": ([f"img_{i}.png" for i in range(4)], [f"img_{i}.dng" for i in range(4)]),
    "no suffix": ([f"img {i}.png" for i in range(4)], [f"img {i}" for i in range(4)]),
    "folders": ([f"{i}.png" for i in range(4)], [f"shots of a coin/{i}.png" for i in range(4)]),
    "a drive": ([f"{i}.png" for i in range(4)], [f"C:\\my shots\\{i}.png" for i in range(4)]),
    "quotation marks": ([f"a {i}.png" for i in range(4)], [f'"a {i}.png"' for i in range(4)]),
    "dots": ([f"v1.b {i}.png" for i in range(4)],) * 2,
}


@pytest.mark.parametrize("kind", NAMES)
def test_names_are_those_of_the_files_however_they_are_written(tmp_path, kind, caplog):
    files, names = NAMES[kind]
    dome(tmp_path, files, names)
    np.testing.assert_allclose(read(tmp_path), LIGHTS, atol=1e-12)
    assert [ONCE in record.getMessage() for record in caplog.records] == [True]  # and nothing else


def test_a_raw_file_is_meant_rather_than_what_was_made_of_it(tmp_path):
    dome(tmp_path, [f"{i}.png" for i in range(4)], [f"{i}.tif" for i in range(4)])
    for i in range(4):
        (tmp_path / f"{i}.dng").write_bytes(b"")

    assert list_folder(tmp_path).names == tuple(f"{i}.dng" for i in range(4))


TEXTS = {
    "decimal commas": [row.replace(".", ",") for row in ROWS],
    "decimal commas in some": [row.replace(".", ",") if i % 2 else row for i, row in enumerate(ROWS)],
    "tabs": [row.replace(" ", "\t") for row in ROWS],
    "commas": [row.replace(" ", ",") for row in ROWS],
    "commas and blanks": [row.replace(" ", ", ") for row in ROWS],
    "semicolons": [row.replace(" ", ";") for row in ROWS],
    "semicolons and decimal commas": [row.replace(" ", "; ").replace(".", ",") for row in ROWS],
    "commas after decimal commas": [row.replace(".", ",").replace(" ", ", ") for row in ROWS],
    "a comma at the end": [f"{row}," for row in ROWS],
    "exponents": ["6e-1 0 8E-1", "0 6e-1 8e-1", "-.6 0 .8", "0 -6.e-1 +.8"],
}


@pytest.mark.parametrize("kind", TEXTS)
@pytest.mark.parametrize("suffix", [".png", ""])
def test_numbers_are_read_however_they_are_written(tmp_path, kind, suffix):
    dome(tmp_path, [f"p {i}.png" for i in range(4)], [f"p {i}{suffix}" for i in range(4)], TEXTS[kind])
    np.testing.assert_allclose(read(tmp_path), LIGHTS, atol=1e-12)
    (tmp_path / "dome.lp").unlink()
    (tmp_path / "light_directions.txt").write_text("\ufeff# towards the light\n\n" + "\r\n".join(TEXTS[kind]))
    np.testing.assert_allclose(read(tmp_path), LIGHTS, atol=1e-12)


@pytest.mark.parametrize(
    "head", ["", "\ufeff4\r\n", "\n# of a dome\n4\n", "// a dome\n4;\n", "4\n\n; x y z\n"], ids=["none", *"abcd"]
)
def test_the_count_may_be_missing_and_comments_are_skipped(tmp_path, head):
    dome(tmp_path, [f"{i}.png" for i in range(4)], [f"{i}.png" for i in range(4)], head=head)
    np.testing.assert_allclose(read(tmp_path), LIGHTS, atol=1e-12)


@pytest.mark.parametrize(
    "names", [["#1.png", "#2.png", "%20a.png", "b.png"], [";a 1.png", "b.png", "c.png", "//d.png"]]
)
def test_names_may_begin_as_comments_do_where_the_count_says_so(tmp_path, names):
    files = [name.removeprefix("//") for name in names]
    dome(tmp_path, files, names, head="# of a dome\n{}\n# x y z\n")
    np.testing.assert_allclose(read(tmp_path), LIGHTS, atol=1e-12)
    (tmp_path / "dome.lp").write_text("1\n# a.png 1 0 0\nb.png 0 0 1\n")
    assert read_lp(tmp_path / "dome.lp").names == ("b.png",)
    (tmp_path / "dome.lp").write_text("1\n")
    with pytest.raises(ValueError, match="must have 1 line after its first"):
        read_lp(tmp_path / "dome.lp")


def test_lengths_and_lights_behind_are_said(tmp_path):
    (tmp_path / "dome.lp").write_text("a.png 0 0 -1.031\nb.png 0 0 -1.061\n")
    lengths, behind = read_lp(tmp_path / "dome.lp").notes
    assert lengths == "the vectors in dome.lp have lengths from 1.031 to 1.061, and are made unit vectors."
    assert behind == "all lights in dome.lp are behind the object, z < 0: z must point to the camera."


def test_a_whole_name_comes_before_its_stem():
    assert by_name(["scan.1", "scan.2"], ["scan.png", "scan.1.png", "scan.2.png"]) == [1, 2]


def test_a_list_in_the_letters_of_an_old_machine_is_read(tmp_path):
    dome(tmp_path, [f"münze{i}.png" for i in range(4)], [f"münze{i}.png" for i in range(4)])
    text = (tmp_path / "dome.lp").read_text(encoding="utf-8")
    (tmp_path / "dome.lp").write_text(text, encoding="latin-1")
    np.testing.assert_allclose(read(tmp_path), LIGHTS, atol=1e-12)


# What is not used is said

OTHERS = {
    "in order": ([f"coin_{i}.png" for i in range(4)], [f"chrome_{i}.jpg" for i in range(4)]),
    "other numbers": ([f"coin_{i}.png" for i in range(4)], [f"chrome_{i}.jpg" for i in range(11, 15)]),
    "no numbers": ([f"coin_{i}.png" for i in range(4)], ["east.jpg", "north.jpg", "west.jpg", "south.jpg"]),
}


@pytest.mark.parametrize("kind", OTHERS)
def test_a_list_with_the_names_of_another_object_is_read_by_order_and_said_once(tmp_path, kind, caplog):
    files, names = OTHERS[kind]
    dome(tmp_path, files, names)
    np.testing.assert_allclose(read(tmp_path), LIGHTS, atol=1e-12)
    said = [record.getMessage() for record in caplog.records if "read by order" in record.getMessage()]
    assert len(said) == 1
    assert f"{names[0]} is coin_0.png, to {names[-1]} is coin_3.png" in said[0]


def test_a_list_that_was_sorted_as_text_is_paired_by_its_numbers(tmp_path):
    numbers = (1, 10, 2, 3)
    dome(tmp_path, [f"coin{i}.png" for i in (1, 2, 3, 10)], [f"chrome{i}.png" for i in numbers])
    np.testing.assert_allclose(read(tmp_path), LIGHTS[[0, 2, 3, 1]], atol=1e-12)


def test_photographs_named_in_a_file_take_the_lights_of_a_list_by_name_or_by_order(tmp_path, caplog):
    dome(tmp_path, [f"Coin_{i}.png" for i in range(4)], [f"chrome_{i}.jpg" for i in range(4)])
    (tmp_path / "filenames.txt").write_text("".join(f"coin_{i}.PNG\n" for i in range(4)))
    np.testing.assert_allclose(read(tmp_path), LIGHTS, atol=1e-12)
    assert "chrome_0.jpg is Coin_0.png" in caplog.text
    (tmp_path / "filenames.txt").write_text("coin_0.png\ncoin_1.png\n")
    np.savetxt(tmp_path / "light_directions.txt", LIGHTS[2:])
    np.testing.assert_allclose(read(tmp_path), LIGHTS[2:], atol=1e-12)
    assert "dome.lp is not used: of 4 lights, it has none for Coin_0.png" in caplog.text


def test_a_second_list_that_differs_is_said(tmp_path, caplog):
    names = [f"{i}.png" for i in range(4)]
    dome(tmp_path, names, names)
    np.savetxt(tmp_path / "light_directions.txt", LIGHTS, fmt="%.2f")
    read(tmp_path)
    assert "differs" not in caplog.text
    np.savetxt(tmp_path / "light_directions.txt", LIGHTS[::-1])
    np.testing.assert_allclose(read(tmp_path), LIGHTS[::-1], atol=1e-12)
    assert "differs from light_directions.txt and is not used" in caplog.text


def test_lengths_and_further_columns_are_said(tmp_path, caplog):
    names = [f"p 3 {i}.png" for i in range(4)]
    dome(tmp_path, names, names, [f"{row} 0.5 7" for row in ROWS])
    np.testing.assert_allclose(read(tmp_path), LIGHTS, atol=1e-12)
    assert "the columns of dome.lp after x, y and z are not used" in caplog.text
    dome(tmp_path, names, names, [f"{60 * x} {60 * y} {60 * z}" for x, y, z in LIGHTS])
    np.testing.assert_allclose(read(tmp_path), LIGHTS, atol=1e-12)
    assert "the vectors in dome.lp have the length 60, and are made unit vectors" in caplog.text
    scale = (3, 1, 2, 9)
    dome(tmp_path, names, names, [f"{s * x} {s * y} {s * z}" for s, (x, y, z) in zip(scale, LIGHTS, strict=True)])
    np.testing.assert_allclose(read(tmp_path), LIGHTS, atol=1e-12)
    assert "1 on line 3 to 9 on line 5, are not used, only their directions" in caplog.text
    caplog.clear()
    dome(tmp_path, names, names, ["0.6 0 0.79", "0 .61 .8", "-.6 0 .8", "0 -.6 .8"])  # of two decimals
    read(tmp_path)
    assert [ONCE in record.getMessage() for record in caplog.records] == [True]


WRONG = {
    "more lights": (range(3), range(4), ROWS, "names '3.png', which is not in its folder; the list has 4 lights, and"),
    "other names, fewer": ("ab", range(4), ROWS, "lists 4 lights, none by the name of one of the 2 photographs"),
    "no photograph": ("", range(4), ROWS, "lists 4 lights, none by the name of one of the 0 photographs"),
    "no direction": (
        range(4),
        range(4),
        [*ROWS[:3], "0 0 0"],
        r"got \[0.0, 0.0, 0.0\], which is no .*line 5",
    ),
    "two numbers": (
        range(4),
        range(4),
        [*ROWS[:3], "0 1"],
        "three numbers a line; got '3.png 0 1' on line 5",
    ),
    "either comma beside points": (range(4), range(4), [*ROWS[:3], "0.1,0.2,0,9"], "got '3.png 0.1,0.2,0,9' on line 5"),
    "either comma": (range(4), range(4), [*ROWS[:3], "0,6,0,0,0,8"], "three numbers a line; got '3.png 0,6,0,0,0,8'"),
    "one name twice": (range(4), (0, 1, 2, 2), ROWS, "names '2.png' twice"),
}


@pytest.mark.parametrize("kind", WRONG)
def test_what_is_wrong_is_one_sentence(tmp_path, kind):
    files, names, rows, said = WRONG[kind]
    dome(tmp_path, [f"{i}.png" for i in files], [f"{i}.png" for i in names], rows)
    with pytest.raises(ValueError, match=said):
        read(tmp_path)


def test_a_list_of_other_names_at_the_terminal(tmp_path, caplog):
    files, names = OTHERS["in order"]
    dome(tmp_path, files, names, [row.replace(".", ",") for row in ROWS])
    with pytest.raises(SystemExit) as stopped:
        main(["texels", str(tmp_path), "--free", "k_d", "-o", str(tmp_path / "maps")])
    assert stopped.value.code == 0
    assert caplog.text.count("read by order") == 1
    assert (tmp_path / "maps" / "k_d.npy").is_file()


def test_commas_are_what_the_line_says():
    assert numbers_in("0,6 0,0 0,8 1,0") == [0.6, 0, 0.8, 1]
    assert numbers_in("1,2,3") == [1, 2, 3]
    assert numbers_in("inf") == [np.inf]
    with pytest.raises(ValueError, match="commas in '0,6,0,8'"):
        numbers_in("0,6,0,8")
    for either in ("0.1,0.2,0,9", "0.5,0,1,7"):
        with pytest.raises(ValueError, match=f"commas in '{either}'"):
            numbers_in(either)
    assert numbers_in("0.6,0,0.8,0.5") == [0.6, 0, 0.8, 0.5]
    assert numbers_in("\N{MINUS SIGN}0.6 0 0.8") == [-0.6, 0, 0.8]


def test_a_long_line_is_refused_quickly(tmp_path):
    (tmp_path / "dome.lp").write_text("1\n" + ".a " * 300_000 + "\n")
    with pytest.raises(ValueError, match="a name and three numbers a line"):
        read_lp(tmp_path / "dome.lp")
