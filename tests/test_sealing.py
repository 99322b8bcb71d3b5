"""Seals: damage is told before a library takes a file apart."""

from __future__ import annotations

import hashlib
import json

import h5py
import numpy as np
import pytest
from support.campaign_files import assert_teaches

from bayes_inertia.errors import CampaignError, OutputError
from bayes_inertia.inference.sampler import load_chain, save_chain
from bayes_inertia.sealing import (
    blaming,
    is_sealed,
    read_sealed_json,
    sealed,
    sha256_of,
    write_sealed,
)

WALKERS, D, STEPS = 8, 2, 3


@pytest.fixture
def chain_file(tmp_path):
    """A chain of three steps, as an interrupted run leaves it."""
    random = np.random.RandomState(np.random.MT19937(1))
    chain = load_chain(tmp_path / "none.h5", WALKERS, D)
    chain.chain = random.normal(size=(STEPS, WALKERS, D))
    chain.log_prob = random.normal(size=(STEPS, WALKERS))
    chain.accepted, chain.iteration = np.ones(WALKERS), STEPS
    chain.random_state = random.get_state()
    path = tmp_path / "ensemble_0.h5"
    save_chain(chain, path)
    return path


def without_seal(path) -> bytes:
    data = path.read_bytes()
    return data[: data.rindex(b"\nbayes-inertia sha256")]


def test_a_sealed_chain_is_read_back_and_by_hdf5_alone(chain_file):
    assert is_sealed(chain_file, "")
    chain = load_chain(chain_file, WALKERS, D)
    assert chain.get_chain().shape == (STEPS, WALKERS, D)
    with h5py.File(chain_file) as file:
        assert file["mcmc/chain"].shape == (STEPS, WALKERS, D)


@pytest.mark.parametrize("place", [0.0, 0.3, 0.9])
def test_one_flipped_bit_is_told(chain_file, place):
    data = bytearray(chain_file.read_bytes())
    data[int(place * (len(data) - 100))] ^= 4
    chain_file.write_bytes(bytes(data))
    with pytest.raises(OutputError, match="is damaged") as caught:
        load_chain(chain_file, WALKERS, D)
    assert_teaches(caught.value, ["ensemble_0.h5", "delete it"])


def test_a_file_without_seal_is_tried_in_another_process(chain_file):
    bare = without_seal(chain_file)
    chain_file.write_bytes(bare)
    assert not is_sealed(chain_file, "")
    assert load_chain(chain_file, WALKERS, D).iteration == STEPS
    chain_file.write_bytes(bare[: len(bare) // 2])
    with pytest.raises(OutputError, match="cannot be read as an HDF5 file"):
        load_chain(chain_file, WALKERS, D)


def test_a_chain_that_is_not_whole_is_refused(chain_file):
    chain_file.write_bytes(without_seal(chain_file))
    with h5py.File(chain_file, "a") as file:
        file["mcmc"].attrs["iteration"] = STEPS + 5
    with pytest.raises(OutputError, match="not a chain"):
        load_chain(chain_file, WALKERS, D)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not the JSON"),
        ("[1]", "not the JSON"),
        ("[" * 100_000, "not the JSON"),
        ('{"a": ' + "9" * 5000 + "}", "not the JSON"),
        ("\xff", "not UTF-8"),
    ],
)
def test_documents_that_are_none(tmp_path, text, message):
    path = tmp_path / "run.json"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(CampaignError, match=message) as caught:
        read_sealed_json(path, "start again")
    assert_teaches(caught.value, ["run.json"])


def test_a_changed_document_is_told_and_an_unsealed_one_is_read(tmp_path):
    path, content = tmp_path / "run.json", {"seed": 1, "x": [1e-17, None], "z": {"b": 1, "a": 2}}
    path.write_text(json.dumps(sealed(content), indent=3))
    assert read_sealed_json(path, "") == sealed(content)
    path.write_text(path.read_text().replace('"seed": 1', '"seed": 2'))
    with pytest.raises(CampaignError, match="was changed since it was written"):
        read_sealed_json(path, "start again")
    path.write_text(json.dumps(content))
    assert read_sealed_json(path, "") == content


def test_only_a_file_without_seal_is_blamed(tmp_path):
    with pytest.raises(CampaignError, match="KeyError"), blaming(tmp_path, intact=False, advice=""):
        {}["a"]
    with pytest.raises(KeyError), blaming(tmp_path, intact=True, advice=""):
        {}["a"]
    with pytest.raises(OutputError), blaming(tmp_path, intact=False, advice=""):
        raise OutputError("disk full")


def test_a_seal_of_a_large_file(tmp_path):
    path = tmp_path / "large"
    write_sealed(path, bytes(3 * 2**20))
    assert is_sealed(path, "")


def test_every_digest_is_the_sha256_of_its_bytes():
    digest = hashlib.sha256("aµb".encode()).hexdigest()
    assert sha256_of("aµ", b"b") == sha256_of("aµb") == digest
