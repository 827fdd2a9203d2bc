"""The command import: lists, jobs and pictures of lens files, and one sentence for every file that it refuses.

Oracle: the job that is read back has the part of `LensFile.part`, whose frame is proved in truth/test_lens_files.
"""

import re

import numpy as np
import pytest

from lens_files import EVEN, ODD, Q_DATA, ZERNIKE_DATA, block, grid_block, write_zmx
from turnwright.cli import main
from turnwright.files import read_lens
from turnwright.job import Job, preview
from turnwright.report import figures

CODE_V = """RDM;LEN
TIT 'doublet'
DIM M
WL 587.6
SO 0 1e13
S 40 3 NBK7_SCHOTT
  STO; CIR 4
S -30 2 SF5
  CIR 4
SI 0 0
GO
"""


@pytest.fixture(autouse=True)
def coarse_pictures(monkeypatch):
    """Write the pictures with an eighth of their pixels along each side: most of the time of a job."""
    write = figures._Canvas.write

    def coarse(canvas, file):
        canvas.figure.set_dpi(20)
        write(canvas, file)

    monkeypatch.setattr(figures._Canvas, "write", coarse)


def lens_file(tmp_path, *surfaces):
    return write_zmx(tmp_path / "lens.zmx", *surfaces)


def run(capsys, *arguments):
    code = main(["import", *map(str, arguments)])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_a_list_says_what_can_be_cut(tmp_path, capsys):
    path = tmp_path / "lens.seq"
    path.write_text(CODE_V)
    code, out, _ = run(capsys, path)
    assert code == 0
    lines = out.splitlines()
    assert lines[0] == "doublet (CODE V, mm, 587.6 nm)"
    assert lines[3].split() == ["1", "stop", "SPH", "40", "4", "air", "NBK7_SCHOTT", "after,", "toward", "+z"]
    assert lines[4].endswith("state --side")


@pytest.mark.parametrize(
    "lines",
    [
        block("EVENASPH", EVEN),
        block("ODDASPHE", ODD),
        block("TOROIDAL", {1: -55.0, 3: 1e-5}),
        block("FZERNSAG", {0: 1.0, 9: 0.3}, ZERNIKE_DATA),
        block("QED_TYPE", extra={1: 1, 2: 4, 3: 6.0} | Q_DATA),
        block("IRREGULA", {1: 0.3, 3: 2.0, 5: 1e-3}, diameter=4.0),
        [*grid_block()[0], "CLAP 0 4"],
        [*block("STANDARD"), "SQAP 3 2", "OBDC 1.5 0.5"],
    ],
    ids=lambda lines: lines[0],
)
def test_a_job_has_the_part_of_the_surface(tmp_path, capsys, lines):
    path, out = lens_file(tmp_path, lines), tmp_path / "job.toml"
    code, printed, _ = run(capsys, path, "--surface", 1, "--out", out)
    assert code == 0
    assert "is toward +z; the tool comes from -z" in printed
    assert "turn about y" in " ".join(out.read_text().split()[:80])
    assert (tmp_path / "job.png").read_bytes().startswith(b"\x89PNG")
    wanted = read_lens(path).part(1)
    job = Job.load(out)
    x, y = np.random.default_rng(1).uniform(-1.0, 1.0, (2, 20)) + np.array([[-1.5], [0.5]])
    assert job.part.surface.sag(x, y) == pytest.approx(wanted.surface.sag(x, y), abs=1e-15)
    assert (job.part.radius, job.part.outline, job.part.material_note) == (wanted.radius, wanted.outline, "N-BK7")


def test_an_imported_job_can_be_checked(tmp_path, capsys):
    out = tmp_path / "job.toml"
    assert run(capsys, lens_file(tmp_path, block("EVENASPH", EVEN)), "--surface", 1, "--out", out)[0] == 0
    assert preview(Job.load(out)).refused == ()


def test_side_radius_and_picture_can_be_chosen(tmp_path, capsys):
    path, picture = tmp_path / "lens.seq", tmp_path / "side.svg"
    path.write_text(CODE_V)
    code, out, _ = run(capsys, path, "--surface", 2, "--side", "after", "--radius", "2.5 mm", "--plot", picture)
    assert code == 0
    assert "into the material after it (SF5)" in out
    assert "aperture: 2.5 mm" in out
    assert "lens file" in picture.read_text()


def test_a_phase_is_stated_and_not_dropped(tmp_path, capsys):
    out = tmp_path / "job.toml"
    path = lens_file(tmp_path, block("BINARY_2", {0: 1}, {1: 2, 2: 6.0, 3: -800.0, 4: 30.0}))
    code, _, err = run(capsys, path, "--surface", 1, "--out", out)
    assert code == 0
    assert "coefficients -800, 30 rad; its relief is not in this part" in err
    assert "-800, 30 rad" in " ".join(out.read_text().replace("\n#", "").split())


def test_first_values_of_code_v_are_radii_or_curvatures(tmp_path, capsys):
    path = tmp_path / "lens.seq"
    path.write_text(CODE_V.replace("RDM;", ""))
    assert "RDM Y" in run(capsys, path, "--surface", 1)[2]
    assert run(capsys, path, "--surface", 1, "--radii")[0] == 0
    assert read_lens(path, radii=False).surface(1).surface.radius == 1 / 40
    assert read_lens(path, radii=True).surface(1).surface.radius == 40.0


WORDS = {
    "a word of a surface": ([*block("STANDARD"), "TWST 1 2"], ("surface 1", "'TWST'")),
    "a type": (block("USERSURF"), ("surface 1", "'USERSURF'")),
    "a parameter": (block("EVENASPH", {9: 1e-3}), ("surface 1", "PARM 9")),
    "an entry": (block("EVENASPH", extra={3: 1e-3}), ("surface 1", "XDAT 3")),
    "no number": ([*block("STANDARD"), "CONI one"], ("surface 1", "CONI", "'one'")),
    "a linear grid": ([*block("GRID_SAG", {0: 1.0})], ("surface 1", "PARM 0")),
    "no grid": (block("GRID_SAG"), ("surface 1", "GDAT")),
    "Zernike within": (block("SZERNSAG", {0: 0.0}, {1: 4, 2: 4.0, 6: 1e-3}), ("surface 1", "4 mm", "5 mm")),
    "an ellipse": ([*block("STANDARD"), "ELAP 3 2"], ("surface 1", "ELAP")),
    "no semi-diameter": (block("STANDARD", diameter=0.0), ("surface 1", "radius of the part")),
    "beyond the conic": (block("STANDARD", diameter=80.0), ("80 mm", "not defined")),
    "Q of no layout": (block("QED_TYPE", extra={1: 1, 2: 1, 3: 6.0, 4: 1e-3, 5: 1e-3}), ("surface 1", "5 entries")),
    "Q-bfs on a conic": (block("QED_TYPE", extra={1: 0, 2: 1, 3: 6.0, 4: 1e-3}), ("surface 1", "conic")),
}


@pytest.mark.parametrize("case", WORDS)
def test_what_is_not_read_names_surface_and_word(tmp_path, capsys, case):
    lines, named = WORDS[case]
    out = tmp_path / "job.toml"
    code, _, err = run(capsys, lens_file(tmp_path, lines, block("STANDARD")), "--surface", 1, "--out", out)
    assert code == 2
    assert err.count("\n") == 1
    assert len(err) < 420
    assert all(word in err for word in named)
    assert not out.exists()
    assert run(capsys, tmp_path / "lens.zmx", "--surface", 2, "--side", "-z")[0] == 0  # another surface serves


CODE_V_WORDS = {
    "SPS QBF": ("SPS QBF", "'SPS QBF'"),
    "TWIST 3": ("TWIST 3", "'TWIST'"),
    "DIF DOE": ("DIF DOE", "'DIF'"),
    "K on a sphere": ("K -1", "SPH"),
    "CUF": ("ASP; CUF 0.1", "CUF"),
    "two values": ("CON; K 1 2", "'1 2'"),
    "ellipse": ("ELX 3; ELY 2", "ELX, ELY"),
    "zoom": ("ZOO 2; ZOO CUY S1 1 2", "ZOO"),
}


@pytest.mark.parametrize("case", CODE_V_WORDS)
def test_what_is_not_read_of_code_v_names_the_word(tmp_path, capsys, case):
    command, named = CODE_V_WORDS[case]
    path = tmp_path / "lens.seq"
    path.write_text(CODE_V.replace("  STO;", f"{command}\n"))
    code, _, err = run(capsys, path, "--surface", 1)
    assert code == 2
    assert "surface 1" in err
    assert named in err
    assert err.count("\n") == 1


FILES = {
    "empty": b"",
    "binary": bytes(range(256)) * 40,
    "of another program": b'LEN NEW "x" 0.2 0.4 3\nEBR 0.4\nRD 100\nNXT\n',
    "not sequential": b"MODE NSC\nUNIT MM\nSURF 0\n",
    "an unknown unit": b"MODE SEQ\nUNIT FURLONG\nSURF 0\n",
    "no unit": b"MODE SEQ\nSURF 0\n  CURV 0\n",
    "no surface": b"MODE SEQ\nUNIT MM\n",
    "an unknown word of the lens": b"MODE SEQ\nUNIT MM\nBEND 3\nSURF 0\n",
    "surfaces out of order": b"MODE SEQ\nUNIT MM\nSURF 0\nSURF 2\n",
    "too many surfaces": b"MODE SEQ\nUNIT MM\n" + b"".join(b"SURF %d\n" % place for place in range(2002)),
    "a command without end": b"RDM Y\nSO 0 1\nS 1 1\n" + b"&\n" * 200_000,
    "a surface that does not exist": b"RDM Y\nSO 0 1\nS 1 1\nK S7 1\nSI 0 0\n",
    "no number of code v": b"RDM Y\nSO 0 1\nS one 1\nSI 0 0\n",
    "a command above the surfaces": b"RDM Y\nTWIST 3\nSO 0 1\nS 1 1\nSI 0 0\n",
}


@pytest.mark.parametrize("case", FILES)
def test_a_file_that_is_no_lens_is_one_sentence(tmp_path, capsys, case):
    path = tmp_path / "lens.zmx"
    path.write_bytes(FILES[case])
    code, out, err = run(capsys, path)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert len(err) < 420


def test_several_configurations_refuse_the_surface_they_change(tmp_path, capsys):
    path = lens_file(tmp_path, block("STANDARD"), block("STANDARD"))
    path.write_text(path.read_text() + "TOL TOFF 0 0\nMNUM 2 1\nCRVT 1 1 0.02 0 0\nCRVT 1 2 0.03 0 0\nWAVE 1 1 0.5\n")
    assert "surface 1 differs between the 2 configurations (CRVT)" in run(capsys, path, "--surface", 1)[2]
    assert run(capsys, path, "--surface", 2, "--side", "before")[0] == 0


def test_wrong_options_are_one_sentence(tmp_path, capsys):
    path = tmp_path / "lens.seq"
    path.write_text(CODE_V)
    (tmp_path / "there.toml").write_text("")
    for arguments, named in (
        (("--surface", 9), "surfaces 0 to 3"),
        (("--surface", 1, "--side", "left"), "before, after, +z or -z"),
        (("--surface", 1, "--radius", "5"), "unit"),
        (("--out", tmp_path / "job.toml"), "--surface"),
        (("--surface", 1, "--out", tmp_path / "there.toml"), "exists"),
        (("--surface", 1, "--out", tmp_path / "job.toml", "--strategy", "fas"), "known"),
        (("--surface", 2), "--side 'before'"),
    ):
        code, _, err = run(capsys, path, *arguments)
        assert code == 2
        assert err.count("\n") == 1
        assert named in err
    assert not (tmp_path / "job.toml").exists()


@pytest.mark.parametrize(("number", "turned"), [(1, True), (2, False)])
def test_the_drawn_l_is_that_of_the_lens_file(tmp_path, monkeypatch, number, turned):
    """Leg along +y, foot along +x of the lens file: on the part, x of a front is reversed. Oracle: rotation by hand."""
    from turnwright.report import lens as pictures

    drawn = []
    monkeypatch.setattr(pictures._Canvas, "write", lambda canvas, _file: drawn.append(canvas.figure))
    glass = block("STANDARD")
    lens = read_lens(lens_file(tmp_path, glass, [line.replace("GLAS N-BK7", "COAT AR") for line in glass]))
    pictures.write_lens_picture(lens.part(number), lens.surface(number), lens.side(number), tmp_path / "l.png")
    top, corner, foot = np.stack(drawn[0].axes[1].lines[-1].get_data(), axis=1)
    assert top - corner == pytest.approx([0.0, 3.5])
    assert foot - corner == pytest.approx([-1.7 if turned else 1.7, 0.0])


def test_heights_that_are_not_finite_write_nothing(tmp_path, capsys):
    for parameters in ({1: 1e308}, {1: 1e308, 2: -1e308}, {3: 1e4}):
        path = lens_file(tmp_path, block("EVENASPH", parameters))
        code, out, err = run(capsys, path, "--surface", 1, "--out", tmp_path / "job.toml")
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert "surface 1 has heights of up to" in err
    assert list(tmp_path.iterdir()) == [path]


def test_a_picture_that_fails_leaves_no_job(tmp_path, capsys, monkeypatch):
    def fail(*_arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("turnwright.report.write_lens_picture", fail)
    path = lens_file(tmp_path, [*grid_block()[0], "CLAP 0 4"])
    assert run(capsys, path, "--surface", 1, "--out", tmp_path / "job.toml")[0] != 0
    assert list(tmp_path.iterdir()) == [path]


def test_the_printed_aperture_is_that_of_the_job(tmp_path, capsys):
    path = lens_file(tmp_path, [*block("STANDARD"), "CLAP 0 4", "OBDC 1.5 0.5"])
    _, out, _ = run(capsys, path, "--surface", 1, "--out", tmp_path / "job.toml")
    assert "aperture: disc 4 mm at (-1.5, 0.5) mm" in out
    assert Job.load(tmp_path / "job.toml").part.outline.centre == (-1.5, 0.5)


def test_the_domain_is_named_to_its_edge(tmp_path, capsys):
    path = lens_file(tmp_path, block("STANDARD"))
    edge = 40.0 / 0.3**0.5  # of a conic of constant -0.7
    assert f"not defined beyond about {edge:.4g} mm" in run(capsys, path, "--surface", 1, "--radius", "300 mm")[2]


def test_what_is_no_file_is_named(tmp_path, capsys):
    assert "is not a file: name a file" in run(capsys, tmp_path)[2]
    (tmp_path / "empty.zmx").write_bytes(b"")
    assert "the limits are 1 and 33,554,432" in run(capsys, tmp_path / "empty.zmx")[2]


def test_a_job_of_a_turned_surface_has_no_negative_zero(tmp_path, capsys):
    path = lens_file(tmp_path, block("FZERNSAG", {0: 1.0, 9: 0.3}, ZERNIKE_DATA))
    assert run(capsys, path, "--surface", 1, "--out", tmp_path / "job.toml")[0] == 0
    assert not re.search(r"-0(\.0)? (um|mm|deg)", (tmp_path / "job.toml").read_text())
