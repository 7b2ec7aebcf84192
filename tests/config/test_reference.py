"""The reference of zerodrift.toml names every key there is."""

from pathlib import Path

import pytest

from zerodrift.base import config

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "zerodrift-toml.md"


@pytest.mark.parametrize("table", config.DATA_TABLES + config.MODEL_TABLES)
def test_reference_has_a_section_for_every_table(table):
    assert any(
        line.startswith("## ") and f"[{table}" in line for line in PAGE.read_text().splitlines()
    )


@pytest.mark.parametrize(
    "key",
    [
        *("name", "time", "temperature", "sample_period_s"),
        *("measured", "reference", "unit", "full_scale"),
        *("train", "test", "dwell", "where", "tared"),
        *config.NETWORK_KEYS,
        *config.NETWORK_OPTIONS,
        *config.NETWORK_KINDS,
        *config.WEIGHT_FORMATS,
        *config.GRU_FORMS,
        *("weights", "out", "files"),
    ],
)
def test_reference_names_every_key_and_choice(key):
    assert f"`{key}`" in PAGE.read_text()
