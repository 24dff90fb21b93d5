"""Writes the small files that the readers are tested with, by independent writers.

    python make.py            (needs numpy, pillow, tifffile, mrcfile)

Every image is of 6 rows and 7 columns, and its pixels follow one formula that the tests repeat (`ramp`), so that
nothing but the files has to be kept. All values are whole numbers, exact in every type.
"""

import pathlib
import struct
import zlib

import mrcfile
import numpy as np
import tifffile
from PIL import Image

HERE = pathlib.Path(__file__).parent
ROWS, COLUMNS = 6, 7


def ramp(dtype, page=0):
    """Value at (row, column): 3 column + 11 row + 5 page, less 40 for signed types."""
    row, column = np.mgrid[:ROWS, :COLUMNS]
    values = 3 * column + 11 * row + 5 * page
    if np.dtype(dtype).kind in "if":
        values = values - 40
    return values.astype(dtype)


def png():
    Image.fromarray(ramp("u1")).save(HERE / "grey8.png", dpi=(300, 300))
    Image.fromarray((ramp("u2") * 100).astype("u2")).save(HERE / "grey16.png")
    grey = ramp("u1")
    alpha = np.full_like(grey, 255)
    Image.fromarray(np.dstack([grey, alpha])).save(HERE / "grey_alpha.png")
    Image.fromarray(np.dstack([grey] * 3)).save(HERE / "rgb_grey.png")
    Image.fromarray(np.dstack([grey, grey, grey + 1])).save(HERE / "rgb_colour.png")
    Image.fromarray(grey).convert("P").save(HERE / "palette.png")
    Image.fromarray(np.tile(np.arange(COLUMNS) % 2 == 1, (ROWS, 1))).save(HERE / "bits1.png")
    # 2e8 px per metre in both directions: 5 nm.
    plain = (HERE / "grey8.png").read_bytes()
    start = plain.index(b"pHYs") - 4
    body = b"pHYs" + struct.pack(">IIB", 200_000_000, 200_000_000, 1)
    chunk = struct.pack(">I", 9) + body + struct.pack(">I", zlib.crc32(body))
    (HERE / "phys_5nm.png").write_bytes(plain[:start] + chunk + plain[start + 21 :])


def tiff():
    def write(name, data, **options):
        tifffile.imwrite(HERE / name, data, metadata=None, software=False, **options)

    for kind in ["u1", "i1", "u2", "i2", "u4", "i4", "f2", "f4", "f8"]:
        write(f"{kind}.tif", ramp(kind))
    write("big_endian.tif", ramp("i2"), byteorder=">")
    write("bigtiff.tif", ramp("u2"), bigtiff=True)
    # libtiff, through Pillow: 317 is the predictor, 278 the rows of a strip.
    lzw = {317: 2, 278: 4}
    Image.fromarray(ramp("u2")).save(HERE / "strips_lzw.tif", compression="tiff_lzw", tiffinfo=lzw)
    Image.fromarray(ramp("f4")).save(HERE / "float_predictor.tif", compression="tiff_adobe_deflate", tiffinfo={317: 3})
    Image.fromarray(ramp("u1")).save(HERE / "packbits.tif", compression="packbits")
    write("strips_deflate.tif", ramp("f4"), rowsperstrip=4, compression="zlib")
    write("tiles.tif", np.tile(ramp("u2"), (3, 3)), tile=(16, 16))
    write("tiles_deflate.tif", np.tile(ramp("f4"), (3, 3)), tile=(16, 16), compression="zlib")
    write("white_is_zero.tif", ramp("u1"), photometric="miniswhite")
    write("rgb_grey.tif", np.dstack([ramp("u1")] * 3), photometric="rgb")
    write("rgb_planar.tif", np.stack([ramp("u1")] * 3), photometric="rgb", planarconfig="separate")
    write("rgb_colour.tif", np.dstack([ramp("u1"), ramp("u1"), ramp("u1") + 1]), photometric="rgb")
    write("complex.tif", ramp("f4").astype("c8"))
    write("pages.tif", np.stack([ramp("i2", page) for page in range(3)]), photometric="minisblack")
    write("dpi300.tif", ramp("u1"), resolution=(300, 300), resolutionunit="INCH")
    write("resolution_2nm.tif", ramp("u1"), resolution=(5e6, 5e6), resolutionunit="CENTIMETER")
    nan = ramp("f4")
    nan[2, 3], nan[4, 1] = np.nan, np.inf
    write("nan.tif", nan)

    stack = np.stack([ramp("u2", page) for page in range(4)])
    tifffile.imwrite(
        HERE / "imagej_um.tif", stack[0], imagej=True, resolution=(800, 800), metadata={"unit": "um"}
    )
    # ImageJ itself escapes the micro sign; resolution 250 px per um is 4 nm/px.
    path = HERE / "imagej_stack.tif"
    tifffile.imwrite(path, stack, imagej=True, resolution=(250, 250), metadata={"unit": "\\u00B5m"})
    # Above 4 GB ImageJ writes one directory only, and the images one behind the other: end the chain after the first.
    with tifffile.TiffFile(path) as file:
        end = file.pages[0].offset + 2 + 12 * len(file.pages[0].tags)
    data = bytearray(path.read_bytes())
    data[end : end + 4] = bytes(4)
    (HERE / "imagej_one_directory.tif").write_bytes(data)
    helios = "[User]\r\nUser=supervisor\r\n[Scan]\r\nPixelWidth=1.25e-009\r\nPixelHeight=1.25e-009\r\n"
    write("fei_helios.tif", ramp("u1"), extratags=[(34682, "s", 0, helios, True)])
    xml = (
        '<?xml version="1.0"?><Metadata><BinaryResult><PixelSize><X unit="m" unitPrefixPower="0">7.5E-10</X>'
        '<Y unit="m" unitPrefixPower="0">7.5E-10</Y></PixelSize></BinaryResult></Metadata>'
    )
    write("fei_xml.tif", ramp("u2"), extratags=[(34680, "s", 0, xml, True)])
    tifffile.imwrite(
        HERE / "ome.tif",
        ramp("u2"),
        ome=True,
        metadata={"axes": "YX", "PhysicalSizeX": 0.003, "PhysicalSizeY": 0.003, "UUID": "none"},
    )


def mrc():
    def write(name, data, pixel_angstrom=12.5, edit=None):
        with mrcfile.new(HERE / name, overwrite=True) as file:
            file.set_data(data)
            if data.ndim == 3:
                file.set_image_stack()
            file.voxel_size = pixel_angstrom
            if edit:
                edit(file)
            # A date would change the files from run to run.
            file.header.label[0] = "made for tests"

    write("mode0.mrc", ramp("i1"))
    write("mode1.mrc", np.stack([ramp("i2", page) for page in range(3)]))
    write("mode2.mrc", ramp("f4"))
    write("mode4.mrc", ramp("f4").astype("c8"))
    write("mode6.mrc", ramp("u2"))
    write("mode12.mrc", ramp("f2"))
    write("placeholder.mrc", ramp("i2"), pixel_angstrom=1.0)

    def fei(file):
        record = np.zeros(3, mrcfile.dtypes.get_ext_header_dtype(b"FEI1", "<"))
        record["Metadata size"] = record.dtype.itemsize
        record["Bitmask 1"] = (1 << 7) | (1 << 14)
        record["Alpha tilt"] = [-10, 0, 10]
        record["Pixel size X"] = 2.5e-9
        file.set_extended_header(record)
        file.header.exttyp = b"FEI1"

    write("fei1.mrc", np.stack([ramp("i2", page) for page in range(3)]), pixel_angstrom=1.0, edit=fei)

    # By hand, as no library writes them: unsigned bytes with IMOD's stamp, an old header without MAP and with FEI's
    # 128-byte records, SerialEM's short integers, and the same file in the other byte order.
    old(HERE / "imod_bytes.mrc", ramp("u1", 30), 0, imod_flags=0)
    old(HERE / "imod_signed.mrc", ramp("i1"), 0, imod_flags=1)
    records = b"".join(
        struct.pack("<32f", tilt, *[0] * 10, 3.36e-9, *[0] * 20) for tilt in (-2.0, 2.0)
    )
    stack = np.stack([ramp("i2", page) for page in range(2)])
    old(HERE / "old_fei.st", stack, 1, extended=records, counts=(0, 32), label=b"Fei Company (c) Copyright 2003")
    big = np.frombuffer(records, "<f4").astype(">f4").tobytes()
    old(HERE / "old_big_endian.st", stack, 1, extended=big, counts=(0, 32), label=b"Fei Company", order=">")
    shorts = struct.pack("<4h", -6000, 1, 6001, 2)
    old(HERE / "serialem.st", stack, 1, extended=shorts, counts=(4, 1 | 16))
    rgb = np.zeros((ROWS, COLUMNS, 3), "u1")
    old(HERE / "mode16.mrc", rgb, 16)


def old(path, data, mode, extended=b"", counts=(0, 0), label=b"", order="<", imod_flags=None):
    """An MRC file without MAP stamp; pixel size unknown (1 A)."""
    sections = data.shape[0] if data.ndim == 3 and mode != 16 else 1
    header = bytearray(1024)
    least, largest = (0, 0) if mode == 16 else (data.min(), data.max())
    struct.pack_into(f"{order}10i6f3i3f", header, 0, COLUMNS, ROWS, sections, mode, 0, 0, 0, COLUMNS, ROWS, sections,
                     COLUMNS, ROWS, sections, 90, 90, 90, 1, 2, 3, least, largest, 0)  # fmt: skip
    struct.pack_into(f"{order}ii", header, 88, 0, len(extended))
    struct.pack_into(f"{order}hh", header, 128, *counts)
    if imod_flags is not None:
        struct.pack_into(f"{order}ii", header, 152, 1146047817, imod_flags)
    struct.pack_into(f"{order}i", header, 220, 1)
    header[224 : 224 + len(label)] = label
    body = data.astype(data.dtype.newbyteorder(order)).tobytes()
    path.write_bytes(bytes(header) + extended + body)


if __name__ == "__main__":
    png()
    tiff()
    mrc()
