"""Text tables as spreadsheets of every country write them."""

from __future__ import annotations

from pathlib import Path

import pytest

from surg_core.reading.text_table import read_table

PLAIN = "t_s,x_m,note\n0.5,-1.25,a\n1.0,2e-3,b c\n"


@pytest.mark.parametrize(
    "data",
    [
        PLAIN.encode(),
        PLAIN.encode("utf-8-sig"),
        PLAIN.encode("utf-16"),
        PLAIN.replace("\n", "\r\n").encode("utf-8-sig"),
        PLAIN.replace("\n", "\r").encode(),
        PLAIN.replace(",", " , ").encode(),
        PLAIN.replace(",", ", ").replace("\n", " \n\n").encode(),
        PLAIN.replace(",", ";").encode(),
        b"sep=;\r\n" + PLAIN.replace(",", ";").replace("\n", "\r\n").encode(),
        PLAIN.replace(",", "\t").encode(),
        PLAIN.replace(",", ";").replace(".", ",").encode(),
        PLAIN.replace(",", "\t").replace(".", ",").encode("utf-8-sig"),
        b'"t_s","x_m","note"\n"0.5","-1.25","a"\n"1.0","2e-3","b c"\n',
        b'"t_s"; "x_m"; "note"\n"0,5"; "-1,25"; "a"\n"1,0"; "2e-3"; "b c"\n',
        b'"t_s"\t"x_m"\t"note"\n"0,5"\t"-1,25"\t"a"\n"1,0"\t"2e-3"\t"b c"\n',
        b"# by hand\n" + PLAIN.encode() + b"# end\n,,\n",
        b"t_s x_m  note\n0.5 -1.25 a\n1.0   2e-3 b_c\n",
    ],
)
def test_every_form_gives_the_same_rows(data: bytes, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_bytes(data)
    header, rows = read_table(tmp_path / "t.csv", ValueError)
    assert header == ("t_s", "x_m", "note")
    assert [(row.number("t_s"), row.number("x_m")) for row in rows] == [(0.5, -1.25), (1.0, 0.002)]
    assert [row.words["note"].replace("_", " ") for row in rows] == ["a", "b c"]


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "t.csv: is empty"),
        (b"\xff\xfe\xff", "is not a text file in UTF-8"),
        (b"a,b\n1,\xe4\n", "is not a text file in UTF-8"),
        (b"a,b\0\n", "byte 0"),
        (b"a,b,a\n1,2,3\n", "t.csv:1: column a is there twice"),
        (b"a,b\n0,5,1,5\n", "t.csv:2: 4 values; the header has 2. A comma in decimals"),
        (b'a,b\n"1,2\n', "t.csv:2: is no row of a table"),
    ],
)
def test_what_is_no_table_is_refused_with_its_line(data: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_bytes(data)
    with pytest.raises(ValueError, match=said):
        read_table(tmp_path / "t.csv", ValueError)


@pytest.mark.parametrize("word", ["1.234,5", "1,2,3", "nan", "inf", "", "1e999"])
def test_what_is_no_finite_number_is_named(word: str, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(f"a;b\n1;x\n{word};y\n")
    _, rows = read_table(tmp_path / "t.csv", ValueError)
    with pytest.raises(ValueError, match=r"t\.csv:3: a: '.*' is not a finite number"):
        rows[1].number("a")
