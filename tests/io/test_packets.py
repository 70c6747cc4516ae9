"""Packets: the header byte by byte, laws of packing, and everything that is no packet."""

import struct
from contextlib import suppress

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from moveset.errors import FormatError
from moveset.io.packets import CONTACTS, HEADER, pack_packet, skeleton_json, unpack_packets
from moveset.motion.skeleton import HML22, KIT21
from tests.motions import wander

WIDTH = 3 + 4 * 22


def changed(packet, at, data):
    return packet[:at] + data + packet[at + len(data) :]


def test_a_packet_byte_by_byte():
    motion, feet = wander(3, seed=1), torch.tensor([[1, 0, 0, 1], [0, 0, 1, 0], [1, 1, 1, 1]], dtype=torch.bool)
    packet = pack_packet(motion, first_frame=2**40 + 7, latency_ms=12.5, planted=feet)
    assert packet[:4] == b"MVST"
    assert struct.unpack("<HHIQffI", packet[4:32]) == (1, 22, 3, 2**40 + 7, 20.0, 12.5, 1)
    rows = np.frombuffer(packet[32 : 32 + 3 * WIDTH * 4], "<f4").reshape(3, WIDTH)
    assert np.array_equal(rows[:, :3], motion.root.numpy())
    assert np.array_equal(rows[:, 3:].reshape(3, 22, 4), motion.rotations.numpy())
    assert packet[32 + 3 * WIDTH * 4 :] == bytes([1, 0, 0, 1, 0, 0, 1, 0, 1, 1, 1, 1])
    assert struct.unpack("<I", pack_packet(motion)[28:32]) == (0,)


@given(pieces=st.lists(st.integers(1, 9), min_size=1, max_size=5), begin=st.integers(0, 2**50), feet=st.booleans())
@settings(max_examples=25, deadline=None)
def test_a_take_in_pieces_is_the_take(pieces, begin, feet):
    motion = wander(sum(pieces), seed=3)
    planted = torch.arange(len(motion) * 4).reshape(-1, 4) % 3 == 0
    data, at = b"", 0
    for n in pieces:
        part = planted[at : at + n] if feet else None
        data += pack_packet(motion[at : at + n], first_frame=begin + at, latency_ms=float(n), planted=part)
        at += n
    take = unpack_packets(data)
    assert torch.allclose(take.motion.rotations, motion.rotations, atol=1e-6)
    assert torch.equal(take.motion.root, motion.root)
    assert (take.first_frame, take.motion.fps, take.latency_ms) == (begin, 20.0, tuple(map(float, pieces)))
    assert torch.equal(take.planted, planted) if feet else take.planted is None


def test_every_cut_is_found():
    packet = pack_packet(wander(2, seed=1), planted=torch.zeros(2, 4, dtype=torch.bool))
    for cut in range(len(packet)):
        with pytest.raises(FormatError):
            unpack_packets(packet[:cut])
        with pytest.raises(FormatError):
            unpack_packets(packet + packet[:cut] if cut else b"")


@pytest.mark.parametrize(
    ("at", "data", "said"),
    [
        (0, b"MVSX", "no packet of version 1"),
        (4, b"\x02\x00", "no packet of version 1"),
        (6, b"\x15\x00", "21 joints, not 22"),
        (8, b"\x00\x00\x00\x00", "0 frames"),
        (8, b"\xff\xff\xff\xff", "cut short"),
        (20, struct.pack("<f", float("nan")), "nan fps"),
        (20, struct.pack("<f", -20.0), "-20 fps"),
        (20, struct.pack("<f", 1e9), "1e\\+09 fps"),
        (28, b"\x02\x00\x00\x00", "unknown flag"),
        (32, struct.pack("<f", float("inf")), "not finite"),
        (32, struct.pack("<f", 3e7), "beyond 1e\\+07"),
        (44, struct.pack("<4f", 0, 0, 0, 0), "unit quaternions"),
        (44, struct.pack("<4f", 0, 0, 0, 1.5), "unit quaternions"),
    ],
)
def test_what_is_no_packet_is_refused(at, data, said):
    with pytest.raises(FormatError, match=said):
        unpack_packets(changed(pack_packet(wander(2, seed=1)), at, data))


def test_packets_must_belong_together():
    one, two = (pack_packet(wander(4, seed=1)[a:b], first_frame=a) for a, b in ((0, 2), (2, 4)))
    assert len(unpack_packets(one + two).motion) == 4
    other = pack_packet(wander(2, seed=1).resampled(30.0), first_frame=2)
    for wrong in (two + one, one + one, one + other):
        with pytest.raises(FormatError, match="should follow"):
            unpack_packets(wrong)
    with pytest.raises(FormatError, match="more than the limit of 10"):
        unpack_packets(one, max_bytes=10)
    with pytest.raises(FormatError, match="more than 3 frames"):
        unpack_packets(one + two, max_frames=3)
    with pytest.raises(FormatError, match="22 joints, not 21"):
        unpack_packets(one, skeleton=KIT21)


@given(st.binary(max_size=300))
@settings(max_examples=200, deadline=None)
def test_noise_is_refused_or_read(noise):
    for data in (noise, HEADER.pack(b"MVST", 1, 22, 1, 0, 20.0, 0.0, CONTACTS) + noise):
        with suppress(FormatError):
            assert len(unpack_packets(data).motion) >= 1


def test_the_skeleton_is_told_to_the_last_bit_that_matters():
    told = skeleton_json()
    assert told["joints"] == list(HML22.joints)
    assert told["parents"] == list(HML22.parents)
    assert told["feet"] == [7, 10, 8, 11]
    assert torch.allclose(torch.tensor(told["offsets"]), HML22.offsets, atol=1e-7)
