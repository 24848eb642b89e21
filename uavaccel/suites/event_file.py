"""TensorBoard's event files, written without it: curves by step.

A record is the length of its data, a checksum of that, the data, and a checksum of them (TFRecord, with Castagnoli's
CRC-32); its data are a protocol buffer `Event` (tensorboard/compat/proto/event.proto and summary.proto).
"""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uavaccel.clock import epoch_s

POLYNOMIAL = 0x82F63B78  # Castagnoli's, lowest bit first
WALL_TIME, STEP, FILE_VERSION, SUMMARY = 0x09, 0x10, 0x1A, 0x2A  # of Event: field number and wire type
VALUE, TAG, SIMPLE_VALUE = 0x0A, 0x0A, 0x15  # of Summary, and of its Value


class EventFile:
    """A new event file in a folder, which is made where it is missing."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._file = (folder / f"events.out.tfevents.{epoch_s():.0f}.{os.getpid()}").open("ab")
        self._add(_counted(FILE_VERSION, b"brain.Event:2"))
        self.write_waiting()

    def add(self, step: int, values: Mapping[str, float]) -> None:
        """Add the value of each curve at a step, which waits for `write_waiting`."""
        summary = b"".join(_before_value(name) + struct.pack("<f", value) for name, value in values.items())
        self._add(bytes([STEP]) + _varint(step) + _counted(SUMMARY, summary))

    def write_waiting(self) -> None:
        """Put the points that wait into the file."""
        self._file.flush()

    def _add(self, fields: bytes) -> None:
        data = struct.pack("<Bd", WALL_TIME, epoch_s()) + fields
        self._file.write(_checked_length(len(data)) + data + _checksum(data))

    def close(self) -> None:
        self._file.close()


def _counted(key: int, data: bytes) -> bytes:
    return bytes([key]) + _varint(len(data)) + data


@lru_cache(maxsize=64)
def _before_value(name: str) -> bytes:
    point = _counted(TAG, name.encode()) + bytes([SIMPLE_VALUE])
    return bytes([VALUE]) + _varint(len(point) + 4) + point


def _varint(number: int) -> bytes:
    """Return a number >= 0 in groups of seven bits, the lowest first; all but the last have the eighth bit set."""
    groups = []
    while number > 0x7F:
        groups.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*groups, number])


@lru_cache(maxsize=64)
def _checked_length(octets: int) -> bytes:
    length = struct.pack("<Q", octets)
    return length + _checksum(length)


def _checksum(data: bytes) -> bytes:
    """Return Castagnoli's CRC-32 of at least four bytes, rotated and offset as TFRecord has it."""
    octets = np.frombuffer(data, np.uint8).copy()
    octets[:4] ^= 0xFF  # what the register begins with
    crc = 0xFFFFFFFF ^ int(np.bitwise_xor.reduce(_remainders(len(data))[np.arange(len(data)), octets]))
    return struct.pack("<I", ((crc >> 15 | crc << 17) + 0xA282EAD8) & 0xFFFFFFFF)


@lru_cache(maxsize=64)
def _remainders(length: int) -> NDArray[np.uint32]:
    """Return the remainder of each octet at each place of so many (length, 256): that of all is their exclusive or."""
    one: NDArray[np.uint32] = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        one = (one >> 1 ^ (one & 1) * np.uint32(POLYNOMIAL)).astype(np.uint32)
    places = [one]
    for _ in range(length - 1):
        places.append(places[-1] >> 8 ^ one[places[-1] & 0xFF])
    return np.stack(places[::-1])
