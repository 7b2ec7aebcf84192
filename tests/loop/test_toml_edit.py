"""Edits of zerodrift.toml: one table changes, every other byte stays."""

import tomllib

import pytest

from zerodrift.base.errors import InputError
from zerodrift.base.toml_edit import add_effect, add_plugin, remove_effect, set_parameters

TEXT = """\
# head
[sensor]  # s
name = "x"

# The physical model, in order.
# See the handbook.
[[effect]]   # first
kind = "zero_tempco"   # c1
order   =   2
# held since the spring

  # about dark
[[effect]]
kind = 'dark_current'


# network comment
[network]  # learns
kind = "gru"

[[effect]]   # a late one
kind = "creep"

# tail
"""


def kinds(text):
    return [effect["kind"] for effect in tomllib.loads(text.lstrip("\ufeff")).get("effect", [])]


def test_new_table_comes_after_the_last_one():
    edited = add_effect(TEXT, "thermal_lag", {"tau_s": 60.0}, {"signal": "body"})
    table = '\n[[effect]]\nkind = "thermal_lag"\nsignal = "body"\ntau_s = 60\n'
    assert edited == TEXT.replace('kind = "creep"\n', 'kind = "creep"\n' + table)


@pytest.mark.parametrize("position", [0, 1, 2])
def test_removal_takes_one_table_and_leaves_the_comments_above_the_next(position):
    edited = remove_effect(TEXT, position)
    left = ["zero_tempco", "dark_current", "creep"]
    del left[position]
    assert kinds(edited) == left
    for comment in ("# The physical model", "# about dark", "# network comment", "# tail"):
        assert comment in edited
    assert edited.index("# network comment") + 18 == edited.index("[network]")


def test_addition_and_removal_cancel():
    assert remove_effect(add_effect(TEXT, "ageing"), 3) == TEXT


def test_first_table_goes_before_the_network_and_its_comment():
    text = '[sensor]\nname = "x"\n\n# learns\n[network]\nkind = "gru"\n'
    edited = add_effect(text, "ageing")
    assert edited == text.replace("# learns", '[[effect]]\nkind = "ageing"\n\n# learns')


def test_first_table_goes_to_the_end_of_a_file_without_other_tables():
    assert add_effect('[sensor]\nname = "x"', "ageing") == (
        '[sensor]\nname = "x"\n\n[[effect]]\nkind = "ageing"\n'
    )


def test_last_table_is_removed_to_none():
    text = '[sensor]\nname = "x"\n\n[[effect]]\nkind = "ageing"\n'
    assert remove_effect(text, 0) == '[sensor]\nname = "x"\n'


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_line_ends_and_byte_order_mark_stay(end, mark):
    text = mark + TEXT.replace("\n", end)
    edited = add_effect(text, "ageing")
    assert edited.startswith(mark)
    assert edited.count("\n") == edited.count(end)
    assert remove_effect(edited, 3) == text


def test_value_is_replaced_in_its_line_and_its_comment_stays():
    text = TEXT.replace("order   =   2", "order   =   2   # for now")
    assert set_parameters(text, 0, {"order": 3.0}) == text.replace("=   2   #", "=   3   #")


def test_new_value_goes_below_the_last_key():
    edited = set_parameters(TEXT, 2, {"tau_s": 12.5})
    assert edited == TEXT.replace('kind = "creep"\n', 'kind = "creep"\ntau_s = 12.5\n')


@pytest.mark.parametrize("edit", [lambda t: add_effect(t, "b"), lambda t: remove_effect(t, 0)])
def test_inline_array_is_refused_with_its_line(edit):
    with pytest.raises(InputError, match=r"zerodrift\.toml:2: .*inline array"):
        edit('[sensor]\neffect = [{kind = "a"}]\n'.replace("[sensor]\n", "\n"))


def test_text_that_looks_like_a_table_inside_a_string_is_left_alone():
    text = 'note = """\n[[effect]]\nkind = "no"\n"""\n\n[[effect]]\nkind = "a"\n'
    edited = remove_effect(add_effect(text, "b"), 0)
    assert kinds(edited) == ["b"]
    assert 'kind = "no"' in edited


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize(
    ("table", "edited"),
    [
        ("", '\n[plugins]\nfiles = ["b.py"]\n'),
        ("\n[plugins]  # own\n", '\n[plugins]  # own\nfiles = ["b.py"]\n'),
        ("\n[plugins]\nfiles = []\n", '\n[plugins]\nfiles = ["b.py"]\n'),
        (
            "\n[plugins]\nfiles = ['a.py', ]  # two\n",
            "\n[plugins]\nfiles = ['a.py', \"b.py\" ]  # two\n",
        ),
        (
            '\n[plugins]\nfiles = ["a.py"]\n\n[fleet]\nname = "y"\n',
            '\n[plugins]\nfiles = ["a.py", "b.py"]\n\n[fleet]\nname = "y"\n',
        ),
    ],
)
def test_a_file_of_effects_is_named_and_all_else_stays(table, edited, end):
    text = (TEXT + table).replace("\n", end)
    assert add_plugin(text, "b.py") == (TEXT + edited).replace("\n", end)


def test_files_in_another_form_are_named_by_hand():
    text = TEXT + '\n[plugins]\nfiles = [\n    "a.py",\n]\n'
    with pytest.raises(InputError, match=r"list on one line\. Name b\.py there by hand"):
        add_plugin(text, "b.py")
