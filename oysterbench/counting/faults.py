"""Faults of an image or video file, found from its bytes: those that decoders ignore, or refuse without a reason."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import simplejpeg

from oysterbench.core.pictures import LARGEST_IMAGE_PX, jpeg_end

AGAIN = "copy it again from the camera"
UNREADABLE = {b"hei": "HEIC", b"hev": "HEIC", b"mif": "HEIC", b"avi": "AVIF", b"crx": "a raw image"}
"""First bytes of the brand of an ISO 14496-12 file -> its format, which OpenCV's wheels cannot decode."""
KIND, WIDTH, HEIGHT, BITS, PHOTOMETRIC, PLANES = 254, 256, 257, 258, 262, 284
"""Tags of a TIFF (Adobe, TIFF 6.0): NewSubfileType, where bit 0 marks a reduced copy of another page; ImageWidth;
ImageLength; BitsPerSample; PhotometricInterpretation, where 0 means that white is 0; PlanarConfiguration, where 2 means
separate planes."""

DAMAGE = ("Corrupt JPEG data", "Premature end of JPEG")
"""Messages of libjpeg for an image whose scans it cannot read to their end; OpenCV reports other errors itself."""
EXTRANEOUS = re.compile(r"(\d+) extraneous bytes before marker 0xd9")
"""Message of libjpeg for bytes between the image and its end marker."""

MOST = 1000
"""Maximum number of pages of a TIFF, and of tags of a page, to examine: more suggest a file made to be slow."""
FORMS = {1: "B", 3: "H", 4: "I"}
"""Type of a TIFF value -> its `struct` format: BYTE, SHORT, LONG."""


def picture_fault(data: bytes) -> str:
    """Reason why the bytes are not a single, complete image; empty if nothing is known to be wrong. Decoders fill in
    the rest of a truncated JPEG or PNG with grey, and decode only the first of several images."""
    if not data:
        return "empty file"
    if data.startswith(b"\xff\xd8") and ((end := jpeg_end(data)) < 0 or _jpeg_damaged(data, end)):
        return f"the JPEG is damaged or ends before its end marker: {AGAIN}"
    if data.startswith(b"\x89PNG") and b"IEND" not in data[-64:]:
        return f"the PNG ends before its end marker: {AGAIN}"
    if data[4:8] == b"ftyp" and (kind := UNREADABLE.get(data[8:11])):
        return f"{kind}, whatever its name says, which cannot be read: save it as JPEG, PNG or TIFF"
    if pages := _tiff_pages(data):
        return _tiff_fault(pages)
    if _moves(data):
        return "an animation: expected one image in a file: save it as a GIF or video, or each image as a file"
    return ""


def picture_size(data: bytes) -> tuple[int, int] | None:
    """Width and height, px, that the header of a JPEG, PNG or TIFF states; None for another format, or if damaged."""
    if data.startswith(b"\xff\xd8"):
        try:
            height, width, *_ = simplejpeg.decode_jpeg_header(data)
        except ValueError:
            return None
        return width, height
    if data.startswith(b"\x89PNG") and len(data) >= 24:
        width, height = struct.unpack_from(">II", data, 16)
        return width, height
    first = next(iter(_tiff_pages(data)), {})
    return (first[WIDTH], first[HEIGHT]) if WIDTH in first and HEIGHT in first else None


def counts_frames(path: Path) -> bool:
    """Whether a video is of a format that stores its number of frames (AVI, MP4, MOV), rather than its duration."""
    with open(path, "rb") as file:
        head = file.read(8)
    return head[:4] == b"RIFF" or head[4:] in (b"ftyp", b"moov", b"mdat", b"free", b"skip", b"wide")


def video_fault(path: Path) -> str:
    """Reason why no frame of a video can be decoded, as far as its bytes tell."""
    size = path.stat().st_size
    if size == 0:
        return "empty file"
    kinds = _boxes(path, size)
    if "ftyp" in kinds and "moov" not in kinds:
        return (
            f"it ends before its index (moov) after {size} bytes, as a recording or copy that was cut short: {AGAIN}, "
            "or have a repair program rebuild the index"
        )
    if "moov" in kinds:
        return (
            "an MP4 or MOV file without images, as of sound alone, or of a codec that OpenCV does not have: convert "
            "it to H.264"
        )
    return f"{size} bytes of no known video format, or of one that is damaged: {AGAIN}"


def _jpeg_damaged(data: bytes, end: int) -> bool:
    """Whether scans of a JPEG are damaged, which OpenCV does not report: it makes up what it cannot read.

    All lost blocks of 512 bytes are found, three quarters of those of 16 bytes, and one in four single bytes: the rest
    decode as a different but valid image (306 images of real dives). end: offset of its end marker.
    """
    try:
        height, width, *_ = simplejpeg.decode_jpeg_header(data)
        if height * width <= LARGEST_IMAGE_PX:
            simplejpeg.decode_jpeg(data, colorspace="GRAY", strict=True)
    except ValueError as error:
        if found := EXTRANEOUS.search(str(error)):
            return len(set(data[end - int(found[1]) : end])) > 1  # if all are equal, a camera padded a block
        return any(words in str(error) for words in DAMAGE)
    return False


def _tiff_fault(pages: list[dict[int, int]]) -> str:
    whole = [page for page in pages if not page.get(KIND, 0) & 1]
    if len(whole) > 1:
        return f"a TIFF of {len(whole)} pages: expected one image in a file: save each page as one"
    first = pages[0]
    if not whole or first is not whole[0]:
        return "a TIFF that begins with a reduced copy: expected one image in a file: save it as JPEG or PNG"
    # OpenCV 5.0 reads these, but returns wrong pixels.
    if first.get(BITS, 8) > 8 and (first.get(PLANES) == 2 or first.get(PHOTOMETRIC) == 0):
        return "a TIFF of 16 bits in separate planes, or with white as 0, cannot be read: save it as PNG"
    return ""


def _tiff_pages(data: bytes) -> list[dict[int, int]]:
    """Tags of each page of a TIFF or BigTIFF, each with the first of its numbers; empty for another format."""
    kinds = {b"II*\0": ("<", False), b"MM\0*": (">", False), b"II+\0": ("<", True), b"MM\0+": (">", True)}
    if data[:4] not in kinds:
        return []
    order, big = kinds[data[:4]]
    offset, count, entry = (f"{order}Q", f"{order}Q", 20) if big else (f"{order}I", f"{order}H", 12)

    def number(form: str, at: int) -> int:
        return int(struct.unpack_from(form, data, at)[0]) if at + struct.calcsize(form) <= len(data) else 0

    pages: list[dict[int, int]] = []
    seen, at = set(), number(offset, 8 if big else 4)
    while 0 < at < len(data) and at not in seen and len(pages) < MOST:
        seen.add(at)
        first, entries = at + struct.calcsize(count), number(count, at)
        page = {}
        for place in range(first, min(first + entry * min(entries, MOST), len(data)), entry):
            held, form = place + entry - struct.calcsize(offset), FORMS.get(number(f"{order}H", place + 2))
            if form is None:
                continue
            size = struct.calcsize(form) * number(offset, place + 4)
            there = held if size <= struct.calcsize(offset) else number(offset, held)
            page[number(f"{order}H", place)] = number(order + form, there)
        pages.append(page)
        at = number(offset, first + entry * entries)
    return pages


def _moves(data: bytes) -> bool:
    """Whether the bytes are an animated WebP or PNG."""
    webp = data[:4] == b"RIFF" and data[8:16] == b"WEBPVP8X" and len(data) > 20 and bool(data[20] & 2)
    return webp or (data.startswith(b"\x89PNG") and b"acTL" in data[: max(0, data.find(b"IDAT"))])


def _boxes(path: Path, size: int) -> list[str]:
    """Kinds of the complete top-level boxes of an MP4 or MOV (ISO 14496-12, 4.2); meaningless for another file."""
    kinds, at = [], 0
    with open(path, "rb") as file:
        while at + 8 <= size:
            file.seek(at)
            head = file.read(16)
            length = int.from_bytes(head[:4], "big")
            length = int.from_bytes(head[8:], "big") if length == 1 else length
            length = length or size - at  # 0: to the end of the file
            if length < 8 or at + length > size:
                break
            kinds.append(head[4:8].decode("latin-1"))
            at += length
    return kinds
