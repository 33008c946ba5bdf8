"""Each function computes what the command of its name computes, to the bit."""

import tomllib

import numpy as np
import pytest

import udc
from conftest import same


def load(path):
    """Pixels of a file of floats, read by NumPy and not by the package."""
    return np.load(path)


@pytest.mark.parametrize("display", ["pentile", "stripe"])
def test_simulate_psf_of_a_display(cli, at, repository, display):
    file = repository / "configs" / "display" / f"{display}.toml"
    cli("psf", "--display", file, "--size", 65, "-o", "psf.npy")
    psf = udc.simulate_psf(file, size=65)
    assert same(psf, load(at("psf.npy")))
    assert np.allclose(psf.sum(axis=(0, 1)), 1, atol=1e-6) and psf.min() >= 0
    assert same(udc.simulate_psf(tomllib.loads(file.read_text()), size=65), psf)


def test_simulate_psf_of_a_random_panel_and_its_display(cli, at):
    cli("psf", "--random", 11, "--size", 65, "-o", "psf.npy", "--display-out", "panel.toml")
    psf, display = udc.simulate_psf(random=11, size=65, return_display=True)
    assert same(psf, load(at("psf.npy")))
    assert same(udc.simulate_psf(display), psf)
    assert same(udc.simulate_psf(at("panel.toml")), psf)


def test_simulate_psf_with_the_errors_of_a_measurement(cli, at, psf):
    udc.write(at("true.exr"), psf)
    flags = ["--turn", 0.3, "--scale", 0.005, "--defocus", 0.4, "--noise", 1e-5, "--reach", 25, "--seed", 3]
    cli("psf", "--from", "true.exr", *flags, "-o", "measured.npy")
    errors = dict(turn=0.3, scale=0.005, defocus=0.4, noise=1e-5, reach=25, seed=3)
    assert same(udc.simulate_psf(from_=psf, **errors), load(at("measured.npy")))


def test_fuse_a_bracket(cli, at, scene):
    times = [1, 0.25, 0.0625]
    pictures = [np.minimum(scene * time, 1).astype(np.float32) for time in times]
    for name, picture in zip("abc", pictures):
        np.save(at(f"{name}.npy"), picture)
    cli("fuse", "a.npy", "b.npy", "c.npy", "--exposures", "1,1/4,1/16", "-o", "fused.exr")
    with pytest.warns(udc.UdcWarning, match="saturated"):
        fused, info = udc.fuse(pictures, exposures=times, return_info=True)
    written, known = udc.read(at("fused.exr"), return_info=True)
    assert same(fused, written) and info == known and info["saturation"] == [16.0] * 3


def test_fuse_a_mosaic_of_integers_with_dark_frames_and_a_mask(cli, at):
    rng = np.random.default_rng(5)
    light = 0.1 + 0.6 * rng.random((64, 64)).cumsum(axis=1) / 64
    pictures = [(64 + 900 * np.minimum(light * time, 1)).astype(np.uint16) for time in (1, 0.25)]
    dark = np.full((64, 64), 64, np.uint16)
    mask = np.ones((64, 64), bool)
    mask[10:12, 30] = False
    for name, picture in [("a", pictures[0]), ("b", pictures[1]), ("dark", dark)]:
        np.save(at(f"{name}.npy"), picture)
    np.save(at("mask.npy"), mask.astype(np.uint8) * 255)
    flags = ["--exposures", "1,1/4", "--white", 964, "--black", 64, "--bayer", "rggb", "--white-balance", "1.9,1,1.6"]
    flags += ["--merge", "weighted", "--mask", "mask.npy", "--dark", "dark.npy", "--allow-motion"]
    cli("fuse", "a.npy", "b.npy", *flags, "-o", "fused.npy")
    fused = udc.fuse(
        pictures,
        exposures=[1, 0.25],
        white=964,
        black=64,
        bayer="rggb",
        white_balance=(1.9, 1, 1.6),
        merge="weighted",
        mask=mask,
        dark=[dark],
        allow_motion=True,
    )
    assert same(fused, load(at("fused.npy")))


@pytest.mark.parametrize("normalize", ["channel", "total"])
@pytest.mark.filterwarnings("ignore::udc.UdcWarning")
def test_fuse_a_point_source_to_a_psf(cli, at, psf, normalize):
    light = np.zeros((81, 81, 3), np.float32)
    light[24:57, 20:53] = 40 * psf / psf.max() * [1, 0.8, 0.5]
    light += 0.001
    times = [1, 1 / 32, 1 / 768]
    pictures = [np.minimum(light * time, 1).astype(np.float32) for time in times]
    for name, picture in zip("abc", pictures):
        udc.write(at(f"{name}.exr"), picture)
    flags = ["--point-source", "--size", 41, "--normalize", normalize]
    cli("fuse", "a.exr", "b.exr", "c.exr", *flags, "-o", "psf.npy")
    measured = udc.fuse(pictures, point_source=True, size=41, normalize=normalize)
    assert same(measured, load(at("psf.npy")))


def test_codes_of_a_psf_and_the_code_of_another(cli, at, psf):
    udc.write(at("psf.exr"), psf)
    cli("codes", "psf.exr", "--angles=-3:3:1.5", "--dim", 3, "-o", "bank.safetensors")
    bank = udc.codes(psf, angles="-3:3:1.5", dim=3)
    written = udc.read(at("bank.safetensors"))
    assert bank.angles == written.angles == [-3, -1.5, 0, 1.5, 3] and bank.names[1] == "r-1.5"
    for part in ["psfs", "codes", "mean", "components", "explained_variance"]:
        assert same(getattr(bank, part), getattr(written, part)), part
    udc.write(at("again.safetensors"), bank)
    assert at("again.safetensors").read_bytes() == at("bank.safetensors").read_bytes()
    assert same(udc.codes(psf, angles=bank.angles, dim=3).codes, bank.codes)
    assert bank.psfs.shape == (5, 33, 33, 3) and len(bank) == 5 and bank.codes.shape == (5, 3)

    other = udc.simulate_psf(from_=psf, turn=0.7)
    udc.write(at("other.exr"), other)
    cli("codes", "--project", "bank.safetensors", "other.exr", "-o", "code.npy")
    code, residual, fits = udc.project(bank, other)
    assert same(code, load(at("code.npy"))) and 0 < residual < 1 and fits


def test_codes_of_a_set_and_of_a_turned_panel(cli, at, repository, psf):
    psfs = [udc.simulate_psf(random=seed, size=33) for seed in range(4)]
    for index, one in enumerate(psfs):
        udc.write(at(f"psf{index}.exr"), one)
    cli("codes", "psf0.exr", "psf1.exr", "psf2.exr", "psf3.exr", "--dim", 2, "-o", "set.safetensors")
    assert same(udc.codes(psfs, dim=2).codes, udc.read_bank(at("set.safetensors")).codes)
    assert same(udc.codes(np.stack(psfs), dim=2).codes, udc.read_bank(at("set.safetensors")).codes)
    display = repository / "configs" / "display" / "stripe.toml"
    cli("codes", "--display", display, "--size", 33, "--angles=-2,0,2", "--dim", 2, "-o", "turned.safetensors")
    udc.write(at("mine.safetensors"), udc.codes(display=display, size=33, angles=[-2, 0, 2], dim=2))
    assert at("mine.safetensors").read_bytes() == at("turned.safetensors").read_bytes()


@pytest.mark.parametrize(
    "flags, settings",
    [
        ([], {}),
        (["--noise", "gaussian:0.01", "--seed", 9, "--x-max", 16], dict(noise="gaussian:0.01", seed=9, x_max=16)),
        (["--noise", "sensor", "--border", "reflect"], dict(noise="sensor", border="reflect")),
        (["--preset", "released", "--x-max", 8, "--margin", 5], dict(preset="released", x_max=8, margin=5)),
    ],
)
def test_degrade_a_scene_through_a_bank(cli, at, scene, psf, flags, settings):
    bank = udc.codes(psf, angles=[-3, 0, 3], dim=2)
    udc.write(at("bank.safetensors"), bank)
    udc.write(at("street.exr"), scene)
    cli("synth", "street.exr", "--bank", "bank.safetensors", "--split", "test", *flags, "-o", "set")
    degraded, info = udc.degrade(scene, bank=bank, name="street", return_info=True, **settings)
    degrader = udc.Degrader(bank=bank, **settings)
    for index, kernel in enumerate(["r-03", "r+00", "r+03"]):
        written, known = udc.read(at(f"set/degraded/{kernel}/street.exr"), return_info=True)
        assert same(degraded[index], written) and info == known
        assert same(degrader(scene, kernel, name="street"), written)
    assert same(degrader.ground_truth(scene), udc.read(at("set/gt/street.exr")))


def test_degrade_a_scene_by_one_psf(cli, at, scene, psf):
    udc.write(at("psf.exr"), psf)
    udc.write(at("street.exr"), scene)
    cli("synth", "street.exr", "--psf", "psf.exr", "--split", "test", "--format", "npy", "-o", "set")
    degraded = udc.degrade(scene, psf, name="street")
    assert same(degraded, load(next(at("set/degraded").glob("*/street.npy"))))
    assert same(udc.degrade(at("street.exr"), at("psf.exr"), name="street"), degraded)


@pytest.fixture
def capture(scene, psf):
    return udc.degrade(scene, psf, x_max=16, noise="gaussian:0.002", return_info=True)


@pytest.mark.parametrize(
    "flags, settings",
    [
        ([], {}),
        (["--true-highlights", "--pose", "psf"], dict(true_highlights=True, pose="psf")),
        (["--refine", 0.5, "--noise", "gaussian:0.002"], dict(refine=0.5, noise="gaussian:0.002")),
        (["--output-domain", "tone-mapped", "--highlights", "blend"], dict(output_domain="tone-mapped", highlights="blend")),
        (["--x-max", 16, "--border", "zero"], dict(x_max=16, border="zero")),
    ],
)
def test_restore_by_the_guided_network(cli, at, capture, psf, flags, settings):
    image, info = capture
    udc.write(at("capture.exr"), image, info=info)
    udc.write(at("psf.exr"), psf)
    cli("restore", "capture.exr", "--psf", "psf.exr", *flags, "-o", "restored.exr")
    restored, found = udc.restore(image, psf=psf, info=info, return_info=True, **settings)
    written, known = udc.read(at("restored.exr"), return_info=True)
    assert same(restored, written)
    assert found.pop("found")["lamps"] and found == known
    assert same(udc.restore(at("capture.exr"), at("psf.exr"), **settings), restored)


@pytest.mark.parametrize(
    "flags, settings",
    [
        (["wiener", "--balance", 0.02, "--mask-saturated"], dict(method="wiener", balance=0.02, mask_saturated=True)),
        (["richardson-lucy", "--iterations", 5], dict(method="richardson-lucy", iterations=5)),
        (["constrained", "--iterations", 5, "--highlights", "keep"], dict(method="constrained", iterations=5, highlights="keep")),
        (["joint", "--border", "periodic"], dict(method="joint", border="periodic")),
        (["wiener-orieux", "--seed", 4], dict(method="wiener-orieux", seed=4)),
    ],
)
def test_restore_by_deconvolution(cli, at, capture, psf, flags, settings):
    image, _ = capture
    np.save(at("capture.npy"), image)
    udc.write(at("psf.exr"), psf)
    cli("restore", "capture.npy", "--psf", "psf.exr", "--method", *flags, "-o", "restored.npy")
    assert same(udc.restore(image, psf, **settings), load(at("restored.npy")))


def test_restore_with_the_psf_of_a_bank(cli, at, capture, psf):
    image, info = capture
    bank = udc.codes(psf, angles=[-3, 0, 3], dim=2)
    udc.write(at("bank.safetensors"), bank)
    udc.write(at("capture.exr"), image, info=info)
    cli("restore", "capture.exr", "--bank", "bank.safetensors", "--angle", 1.25, "-o", "restored.npy")
    restored = udc.restore(image, bank=bank, angle=1.25, info=info)
    assert same(udc.restore(image, bank=bank, angle="1.25", info=info), restored)
    assert same(restored, load(at("restored.npy")))


@pytest.mark.parametrize(
    "flags, settings",
    [
        ([], {}),
        (["--curve", "aces", "--max", 2], dict(curve="aces", max=2)),
        (["--gamma", 2.2, "--no-clip", "--no-clahe"], dict(gamma=2.2, no_clip=True, no_clahe=True)),
        (["--orientation", 6, "--saturation", "2,1.5,1.8", "--baseline-exposure", 0.5], None),
        (["--clip-limit", 2, "--grid", 2, "--clip", 4, "--curve", "srgb"], dict(clip_limit=2, grid=2, clip=4, curve="srgb")),
    ],
)
@pytest.mark.parametrize("bits", [8, 16])
def test_finish(cli, at, scene, flags, settings, bits):
    if settings is None:
        settings = dict(orientation=6, saturation=(2, 1.5, 1.8), baseline_exposure=0.5)
    np.save(at("light.npy"), scene)
    cli("finish", "light.npy", *flags, "--bits", bits, "-o", "picture.png")
    picture = udc.finish(scene, bits=bits, **settings)
    assert picture.dtype == (np.uint8 if bits == 8 else np.uint16)
    udc.write(at("mine.png"), picture)
    assert at("mine.png").read_bytes() == at("picture.png").read_bytes()


def test_finish_with_a_matrix_and_a_reference_to_floats(cli, at, scene):
    matrix = [[1.8, -0.6, -0.2], [-0.2, 1.5, -0.3], [0.0, -0.6, 1.6]]
    (at("ccm.txt")).write_text("ccm: " + " ".join(str(value) for row in matrix for value in row) + "\n")
    reference = (np.clip(scene, 0, 1) * 255).astype(np.uint8)
    udc.write(at("reference.png"), reference)
    np.save(at("light.npy"), scene)
    cli("finish", "light.npy", "--ccm", "ccm.txt", "--reference", "reference.png", "-o", "picture.exr")
    written = udc.read(at("picture.exr"), domain="linear")
    assert same(udc.finish(scene, ccm=matrix, reference=reference, bits=32), written)
    assert same(udc.finish(at("light.npy"), ccm=at("ccm.txt"), reference=at("reference.png"), bits=32), written)


@pytest.mark.parametrize("definition", ["released", "float"])
def test_psnr_and_ssim(cli, at, capture, scene, definition):
    import json

    image, _ = capture
    for folder, pixels in [("restored", image), ("clean", scene)]:
        at(folder).mkdir()
        udc.write(at(f"{folder}/a.exr"), pixels)
    flags = ["--definition", definition, "--alpha", 0.25, "--x-max", 16]
    cli("eval", "--restored", "restored", "--gt", "clean", *flags, "-o", "results")
    text = json.dumps(json.loads(at("results/metrics.json").read_text()))
    for measure in (udc.psnr, udc.ssim):
        value = measure(image, scene, definition=definition, x_max=16)
        assert json.dumps(value) in text, f"{value} in {text}"
        assert measure(at("restored/a.exr"), scene, definition=definition, x_max=16) == value
    assert udc.psnr(scene, scene) == np.inf and udc.ssim(scene, scene) == pytest.approx(1)


def test_files_are_read_and_written_as_the_program_does(cli, at, scene):
    for extension in ["npy", "exr", "hdr"]:
        udc.write(at(f"a.{extension}"), scene)
        cli("convert", f"a.{extension}", f"{extension}.npy")
        assert same(udc.read(at(f"a.{extension}")), load(at(f"{extension}.npy")))
    assert same(udc.read(at("a.npy")), scene) and same(udc.read(at("a.exr")), scene)
    udc.write(at("half.exr"), scene, half=True)
    assert same(udc.read(at("half.exr")), scene.astype(np.float16).astype(np.float32))
    psf = np.zeros((5, 5, 3), np.float32)
    psf[2, 2] = 2
    udc.write(at("psf.exr"), psf)
    assert same(udc.read_psf(at("psf.exr")), psf / 2)
