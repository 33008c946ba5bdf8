"""What only Python has: dtypes and layouts, errors, threads, pickles, forks."""

import logging
import os
import pickle
import signal
import subprocess
import sys
import textwrap
import threading
import time

import numpy as np
import pytest

import udc
from conftest import planar, same


def test_results_are_views_of_planar_memory(scene, psf):
    for image in [udc.degrade(scene, psf), udc.restore(scene, psf, method="wiener"), udc.finish(scene), psf]:
        assert image.shape[-1] == 3 and not image.flags.owndata
        assert np.moveaxis(image, -1, 0).flags.c_contiguous and image.flags.writeable


@pytest.mark.parametrize(
    "change",
    [
        planar,
        np.asfortranarray,
        lambda image: image.astype(np.float64),
        lambda image: image.astype(">f4"),
        lambda image: np.repeat(np.repeat(image, 2, 0), 2, 1)[::2, ::2],
        lambda image: image[::-1, ::-1][::-1, ::-1],
        lambda image: image.tolist(),
    ],
    ids=["planar", "fortran", "float64", "big-endian", "strided", "reversed", "list"],
)
def test_any_layout_and_kind_of_float_is_the_same_image(scene, psf, change):
    expected = udc.degrade(scene, psf, noise="gaussian:0.01")
    assert same(udc.degrade(change(scene), change(psf), noise="gaussian:0.01"), expected)
    assert same(udc.finish(change(scene)), udc.finish(scene))
    assert udc.psnr(change(scene), change(expected)) == udc.psnr(scene, expected)


def test_inputs_stay_as_they_are(scene, psf):
    before = scene.copy(), psf.copy()
    capture = udc.degrade(scene, psf, x_max=8)
    udc.restore(capture, psf, x_max=8)
    udc.finish(scene)
    assert same(scene, before[0]) and same(psf, before[1])
    scene.flags.writeable = False
    try:
        assert same(udc.degrade(scene, psf, x_max=8), capture)
    finally:
        scene.flags.writeable = True


def test_grey_images_become_three_equal_channels(psf):
    grey = np.linspace(0, 1, 400, dtype=np.float32).reshape(20, 20)
    assert same(udc.degrade(grey, psf), udc.degrade(np.repeat(grey[..., None], 3, -1), psf))


def test_integers_must_be_told(scene, psf):
    picture = (np.clip(scene, 0, 1) * 255).astype(np.uint8)
    with pytest.raises(udc.UdcError, match="scene: .*add domain linear or domain srgb"):
        udc.degrade(picture, psf)
    linear = udc.degrade(picture, psf, domain="linear")
    assert same(linear, udc.degrade(picture.astype(np.float32) / np.float32(255), psf))
    assert udc.degrade(picture, psf, domain="srgb").mean() < linear.mean()


def test_one_pixel_goes_through(psf):
    pixel = np.full((1, 1, 3), 0.5, np.float32)
    assert udc.degrade(pixel, psf).shape == (1, 1, 3)
    assert udc.finish(pixel).shape == (1, 1, 3)
    assert udc.psnr(pixel, pixel) == np.inf
    assert udc.restore(pixel, psf).shape == (1, 1, 3)


def with_a_nan(scene):
    image = scene.copy()
    image[2, 3, 1] = np.nan
    return image


@pytest.mark.parametrize(
    "work, message",
    [
        (lambda s, p: udc.restore(s), "guided restoration needs the panel's PSF: name it with psf"),
        (lambda s, p: udc.restore(with_a_nan(s), p), "capture: .*NaN at row 2, column 3, channel 1"),
        (lambda s, p: udc.restore(np.moveaxis(s, -1, 0), p), r"capture: expected an image \[H, W, 3\].*moveaxis"),
        (lambda s, p: udc.restore(s[:0], p), "at least 1 × 1"),
        (lambda s, p: udc.restore(s.astype(np.int64), p), "capture: expected float32.*int64"),
        (lambda s, p: udc.restore(s.astype(complex), p), "capture: expected float32.*complex"),
        (lambda s, p: udc.restore(object(), p), "capture: expected a path or an array"),
        (lambda s, p: udc.restore(s, p, method="magic"), "method: must be one of wiener, .*magic"),
        (lambda s, p: udc.restore(s, p, method="wiener", refine=0.5), "refine: does not belong"),
        (lambda s, p: udc.restore(s, p, balance=0.5), "balance: does not belong"),
        (lambda s, p: udc.restore(s, p, refine=2), "refine: must be between 0 and 1"),
        (lambda s, p: udc.restore(s, p, max_memory="a lot"), "max_memory"),
        (lambda s, p: udc.restore(s, p, max_memory="1MiB"), "max_memory"),
        (lambda s, p: udc.restore(s, p, info={"saturation": [1, 0, 1]}), "info: saturation"),
        (lambda s, p: udc.restore(s, p, x_max=-1), "x_max: "),
        (lambda s, p: udc.restore(s, np.zeros_like(p)), "psf: .*channel 0"),
        (lambda s, p: udc.degrade(s), "either a psf or a bank"),
        (lambda s, p: udc.degrade(s, p, margin=40), "margin"),
        (lambda s, p: udc.degrade(s, p, noise="loud"), "noise"),
        (lambda s, p: udc.degrade(s, p, kernel=1), "kernel: must be from 0 to 0"),
        (lambda s, p: udc.finish(s, ccm=np.eye(2)), "ccm: expected a matrix"),
        (lambda s, p: udc.finish(s, ccm=np.ones((3, 3))), "ccm"),
        (lambda s, p: udc.finish(s, curve="srgb", gamma=2), "gamma belongs to curve gamma"),
        (lambda s, p: udc.finish(s, bits=12), "bits: must be one of 8, 16, 32"),
        (lambda s, p: udc.finish(s, orientation=9), "orientation"),
        (lambda s, p: udc.finish(s, no_clip=True, clip=3), "no_clip"),
        (lambda s, p: udc.psnr(s, s[1:]), "image|expected"),
        (lambda s, p: udc.ssim(s[:5], s[:5]), "SSIM|11|window"),
        (lambda s, p: udc.psnr(s, s, definition="mine"), "definition"),
        (lambda s, p: udc.codes(p, dim=99), "dim|rotations|directions|codes"),
        (lambda s, p: udc.codes([]), "at least one PSF"),
        (lambda s, p: udc.codes([p, p[1:-1]]), "33 × 33|31 × 33|size"),
        (lambda s, p: udc.simulate_psf(), "name one of display, random and from_"),
        (lambda s, p: udc.simulate_psf({"sensor": {"pixels": 3}}), "display: .*pixels"),
        (lambda s, p: udc.simulate_psf(random=1, size=0), "size"),
        (lambda s, p: udc.fuse([]), "picture"),
        (lambda s, p: udc.fuse([s, s], exposures=[1]), "exposure|picture|time"),
        (lambda s, p: udc.fuse([s], size=3), "point_source"),
    ],
)
def test_what_is_wrong_is_said(scene, psf, work, message):
    with pytest.raises(udc.UdcError, match=message) as raised:
        work(scene, psf)
    assert isinstance(raised.value, ValueError) and "--" not in str(raised.value)
    assert "/tmp" not in str(raised.value)


def test_files_that_are_missing_or_there_are_errors_of_the_system(tmp_path, scene):
    missing = tmp_path / "Größe ß.exr"
    with pytest.raises(FileNotFoundError, match="Größe ß.exr") as raised:
        udc.read(missing)
    assert isinstance(raised.value, udc.UdcIOError) and raised.value.errno == 2
    udc.write(missing, scene)
    with pytest.raises(udc.UdcError):
        udc.write(missing, scene)
    udc.write(missing, scene[:9], overwrite=True)
    assert udc.read(missing).shape == (9, 83, 3)
    with pytest.raises(OSError):
        udc.write(tmp_path / "nowhere" / "a.exr", scene)
    with pytest.raises(udc.UdcError, match="linear|up to 1"):
        udc.write(tmp_path / "light.png", scene)
    assert not list(tmp_path.glob("light*")) and len(list(tmp_path.iterdir())) == 1


def test_nothing_is_left_in_the_folder_of_temporary_files(tmp_path, monkeypatch, scene, psf):
    import tempfile

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    udc.restore(scene, psf, method="wiener")
    with pytest.raises(udc.UdcError):
        udc.restore(scene, -psf, method="wiener")
    assert not list(tmp_path.iterdir())


def test_warnings_and_the_log(caplog, scene, psf):
    off = np.roll(np.pad(psf, ((9, 9), (9, 9), (0, 0))), 5, axis=0)
    with pytest.warns(udc.UdcWarning, match="psf: "):
        udc.restore(scene, off, method="wiener")
    with caplog.at_level(logging.INFO, "udc"):
        udc.restore(scene, off, method="wiener", recenter=True)
    assert "moved to the centre" in caplog.text


def test_threads_compute_at_the_same_time_and_the_same(scene, psf):
    degrader = udc.Degrader(psf, noise="gaussian:0.01")
    expected = [degrader(scene, name=str(index)) for index in range(8)]
    found = [None] * 8

    def work(index):
        for _ in range(5):
            found[index] = degrader(scene, name=str(index))

    threads = [threading.Thread(target=work, args=(index,)) for index in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(same(a, b) for a, b in zip(found, expected))


def test_the_lock_is_released(scene, psf):
    capture = udc.degrade(np.tile(scene, (3, 3, 1)), psf, x_max=16)
    done, turns = threading.Event(), 0

    def work():
        udc.restore(capture, psf, x_max=16)
        done.set()

    thread = threading.Thread(target=work)
    start = time.monotonic()
    thread.start()
    while not done.is_set():
        turns += 1
        time.sleep(0.001)
    thread.join()
    # One turn takes a little more than a millisecond, unless the lock is held all the while.
    assert turns > 20 * (time.monotonic() - start), turns


def test_any_number_of_threads_computes_the_same(scene, psf):
    expected = udc.restore(scene, psf)
    try:
        udc.set_threads(1)
        assert same(udc.restore(scene, psf), expected)
    finally:
        udc.set_threads(0)


def test_degraders_are_pickled(scene, psf):
    bank = udc.codes(psf, angles=[-3, 0, 3], dim=2)
    for degrader in [udc.Degrader(psf, noise="sensor", seed=4), udc.Degrader(bank=bank)]:
        copy = pickle.loads(pickle.dumps(degrader))
        kernel = len(degrader) - 1
        assert copy.names == degrader.names and same(copy(scene, kernel), degrader(scene, kernel))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="a system without fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_forked_process_computes(scene, psf):
    degrader = udc.Degrader(psf)
    expected = degrader(scene)
    child = os.fork()
    if child == 0:
        signal.alarm(60)
        os._exit(0 if same(degrader(scene), expected) else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_an_interrupt_ends_the_work():
    # A job in the background of a shell is born deaf to interrupts, and so are its children.
    program = textwrap.dedent("""
        import signal
        import numpy as np, udc
        signal.signal(signal.SIGINT, signal.default_int_handler)
        psf = udc.simulate_psf(random=7, size=65)
        print("ready", flush=True)
        try:
            noise = np.random.default_rng(0).gamma(0.5, 1.0, (900, 900, 3)).astype(np.float32)
            udc.restore(noise, psf, method="richardson-lucy", iterations=100000)
        except KeyboardInterrupt:
            print("interrupted", flush=True)
    """)
    child = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert child.stdout.readline() == "ready\n"
    time.sleep(1)
    child.send_signal(signal.SIGINT)
    try:
        out, _ = child.communicate(timeout=120)
    finally:
        child.kill()
    assert out == "interrupted\n" and child.returncode == 0


def test_every_function_says_what_it_takes():
    for name in udc.__all__:
        assert name == "__version__" or getattr(udc, name).__doc__, name


def test_the_ten_lines(tmp_path, repository):
    script = repository / "docs" / "degrade_and_restore.py"
    done = subprocess.run([sys.executable, script, tmp_path], capture_output=True, text=True, check=True)
    before, after = (float(line.split()[1]) for line in done.stdout.splitlines())
    assert after > before + 1, done.stdout
    assert (tmp_path / "restored.png").read_bytes()[:4] == b"\x89PNG"
