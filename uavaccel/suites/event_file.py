"""TensorBoard's event files, written without it: curves by step, each record in the file as soon as it is known.

A record is the length of its data, a checksum of that, the data, and a checksum of them (TFRecord, with Castagnoli's
CRC-32); its data are a protocol buffer `Event` (tensorboard/compat/proto/event.proto and summary.proto).
"""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping
from pathlib import Path

from uavaccel.clock import epoch_s

POLYNOMIAL = 0x82F63B78  # Castagnoli's, lowest bit first
WALL_TIME, STEP, FILE_VERSION, SUMMARY = 0x09, 0x10, 0x1A, 0x2A  # of Event: field number and wire type
VALUE, TAG, SIMPLE_VALUE = 0x0A, 0x0A, 0x15  # of Summary, and of its Value


class EventFile:
    """A new event file in a folder, which is made where it is missing."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._file = (folder / f"events.out.tfevents.{epoch_s():.0f}.{os.getpid()}").open("ab")
        self._write(_counted(FILE_VERSION, b"brain.Event:2"))

    def add(self, step: int, values: Mapping[str, float]) -> None:
        """Write the value of each curve at a step."""
        points = (
            _counted(TAG, name.encode()) + struct.pack("<Bf", SIMPLE_VALUE, value) for name, value in values.items()
        )
        summary = b"".join(_counted(VALUE, point) for point in points)
        self._write(bytes([STEP]) + _varint(step) + _counted(SUMMARY, summary))

    def _write(self, fields: bytes) -> None:
        data = struct.pack("<Bd", WALL_TIME, epoch_s()) + fields
        length = struct.pack("<Q", len(data))
        self._file.write(length + _checksum(length) + data + _checksum(data))
        self._file.flush()

    def close(self) -> None:
        self._file.close()


def _counted(key: int, data: bytes) -> bytes:
    return bytes([key]) + _varint(len(data)) + data


def _varint(number: int) -> bytes:
    """Return a number >= 0 in groups of seven bits, the lowest first; all but the last have the eighth bit set."""
    groups = []
    while number > 0x7F:
        groups.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*groups, number])


def _checksum(data: bytes) -> bytes:
    """Return Castagnoli's CRC-32, rotated and offset as TFRecord has it."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc = _REMAINDERS[(crc ^ byte) & 0xFF] ^ crc >> 8
    crc ^= 0xFFFFFFFF
    return struct.pack("<I", ((crc >> 15 | crc << 17) + 0xA282EAD8) & 0xFFFFFFFF)


def _remainder(byte: int) -> int:
    for _ in range(8):
        byte = byte >> 1 ^ (POLYNOMIAL if byte & 1 else 0)
    return byte


_REMAINDERS = [_remainder(byte) for byte in range(256)]
