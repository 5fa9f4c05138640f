"""Files of pixels whose bytes are laid out here, so that no library has a say in what their samples are."""

import struct
import zlib

import numpy as np

CODES = {1: "B", 2: "s", 3: "H", 4: "I", 12: "d", 16: "Q"}


def png(samples, bits=None, colour=None, palette=b""):
    """Bytes of a PNG; samples (height, width) or (height, width, channels), each of so many bits."""
    samples = np.asarray(samples)
    bits = bits or 8 * samples.dtype.itemsize
    channels = 1 if samples.ndim == 2 else samples.shape[2]
    colour = {1: 0, 2: 4, 3: 2, 4: 6}[channels] if colour is None else colour
    height, width = samples.shape[:2]
    if bits < 8:
        digits = ["".join(f"{sample:0{bits}b}" for sample in row) for row in samples.tolist()]
        rows = [int(row + "0" * (-len(row) % 8), 2).to_bytes(-(-len(row) // 8), "big") for row in digits]
    else:
        rows = [row.tobytes() for row in samples.astype(f">u{bits // 8}")]

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0))
    body = chunk(b"IDAT", zlib.compress(b"".join(b"\0" + row for row in rows)))
    colours = chunk(b"PLTE", palette) if palette else b""
    return b"\x89PNG\r\n\x1a\n" + head + colours + body + chunk(b"IEND", b"")


def tiff(
    samples,
    order="<",
    compression=1,
    predictor=1,
    rows=None,
    tile=None,
    planar=1,
    big=False,
    tags=(),
    photometric=None,
):
    """Bytes of a TIFF; tags are (tag, type, values) besides those of its layout, which they replace."""
    samples = np.asarray(samples)
    height, width = samples.shape[:2]
    channels = 1 if samples.ndim == 2 else samples.shape[2]
    cube = samples.reshape(height, width, channels)
    planes = [cube] if planar == 1 else [cube[:, :, k : k + 1] for k in range(channels)]
    block_height, block_width = tile or (rows or height, width)
    blocks = [
        packed(block(plane, row, column, block_height, block_width, tile), order, compression, predictor)
        for plane in planes
        for row in range(0, height, block_height)
        for column in range(0, width, block_width)
    ]
    start = 16 if big else 8
    starts = np.cumsum([start, *map(len, blocks)])[:-1].tolist()
    entries = {
        256: (4, [width]),
        257: (4, [height]),
        258: (3, [8 * samples.dtype.itemsize] * channels),
        259: (3, [compression]),
        262: (3, [photometric if photometric is not None else 2 if channels >= 3 else 1]),
        277: (3, [channels]),
        284: (3, [planar]),
        317: (3, [predictor]),
        339: (3, [{"u": 1, "i": 2, "f": 3}[samples.dtype.kind]] * channels),
    }
    entries |= {322: (4, [block_width]), 323: (4, [block_height])} if tile else {278: (4, [block_height])}
    entries |= {324 if tile else 273: (4, starts), 325 if tile else 279: (4, list(map(len, blocks)))}
    entries |= {tag: (kind, values) for tag, kind, values in tags}
    body = b"".join(blocks)
    word, inline = ("Q", 8) if big else ("I", 4)
    at = start + len(body)
    directory, extra = struct.pack(order + ("Q" if big else "H"), len(entries)), b""
    beyond = at + len(directory) + len(entries) * (20 if big else 12) + inline
    for tag, (kind, values) in sorted(entries.items()):
        if kind == 2:
            data, count = values, len(values)
        else:
            data, count = struct.pack(f"{order}{len(values)}{CODES[kind]}", *values), len(values)
        directory += struct.pack(order + "HH" + word, tag, kind, count)
        if len(data) <= inline:
            directory += data.ljust(inline, b"\0")
        else:
            directory += struct.pack(order + word, beyond + len(extra))
            extra += data
    head = (b"II" if order == "<" else b"MM") + (
        struct.pack(order + "HHHQ", 43, 8, 0, at) if big else struct.pack(order + "HI", 42, at)
    )
    return head + body + directory + bytes(inline) + extra


def block(plane, row, column, height, width, tile):
    """A strip, the last one shorter, or a tile, with anything beyond the image's edges."""
    part = plane[row : row + height, column : column + width]
    if tile is None:
        return part
    whole = np.full((height, width, part.shape[2]), 77).astype(plane.dtype)
    whole[: part.shape[0], : part.shape[1]] = part
    return whole


def packed(part, order, compression, predictor):
    """Bytes of a block."""
    ordered = part.astype(part.dtype.newbyteorder(order))
    data = ordered.tobytes()
    if predictor == 2:
        unsigned = np.ascontiguousarray(part).view(f"u{part.dtype.itemsize}")
        steps = unsigned.copy()
        steps[:, 1:] = unsigned[:, 1:] - unsigned[:, :-1]
        data = steps.astype(steps.dtype.newbyteorder(order)).tobytes()
    elif predictor == 3:
        rows, columns, depth = part.shape
        size = part.dtype.itemsize
        highest_first = np.frombuffer(part.astype(part.dtype.newbyteorder(">")).tobytes(), np.uint8)
        ranked = highest_first.reshape(rows, columns * depth, size).swapaxes(1, 2).reshape(rows, -1, depth)
        steps = ranked.copy()
        steps[:, 1:] = ranked[:, 1:] - ranked[:, :-1]
        data = steps.tobytes()
    return {
        1: bytes,
        5: lzw,
        8: zlib.compress,
        32946: zlib.compress,
        32773: lambda data: pack_bits(data, part),
    }[compression](data)


def pack_bits(data, part):
    """Bytes as runs of bytes that are not repeated, row by row."""
    width = part[0].nbytes
    rows = [data[k : k + width] for k in range(0, len(data), width)]
    return b"".join(
        bytes([len(piece) - 1]) + piece
        for row in rows
        for piece in (row[k : k + 100] for k in range(0, width, 100))
    )


def lzw(data):
    """Lempel, Ziv and Welch, as TIFF has it: codes of 9 to 12 bits, the highest bit first, longer one code early."""
    clear, end = 256, 257
    table, digits, known = {bytes([k]): k for k in range(256)}, f"{clear:09b}", b""
    added = end  # the last code that the table has
    for byte in data:
        more = known + bytes([byte])
        if more in table:
            known = more
            continue
        digits += f"{table[known]:0{length(added)}b}"
        added += 1
        table[more], known = added, bytes([byte])
        if added == 4094:
            digits += f"{clear:012b}"
            table, added = {bytes([k]): k for k in range(256)}, end
    digits += f"{table[known]:0{length(added)}b}" + f"{end:0{length(added + 1)}b}"
    digits += "0" * (-len(digits) % 8)
    return int(digits, 2).to_bytes(len(digits) // 8, "big")


def length(added):
    """Bits of the next code."""
    return 9 + sum(added >= last for last in (511, 1023, 2047))
