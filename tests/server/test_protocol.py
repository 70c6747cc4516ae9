"""Messages: what is understood, and that everything else is refused in a sentence."""

import json
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moveset.server.protocol import ChangePrompt, GenerateBody, Played, Set, Start, plain, read_message


def test_what_clients_may_say():
    start = read_message('{"type": "start", "prompt": " a person\\n walks ", "seed": 7, "commit": 10}')
    assert start == Start(type="start", prompt="a person walks", seed=7, commit=10)
    assert start.buffer == 2.0
    assert read_message('{"type":"start"}').prompt is None
    assert read_message('{"type":"prompt","text":"bow"}') == ChangePrompt(type="prompt", text="bow")
    assert read_message('{"type":"played","frame":28}') == Played(type="played", frame=28)
    assert read_message('{"type":"set","buffer":3,"steps":2}') == Set(type="set", buffer=3.0, steps=2)
    assert [read_message(f'{{"type":"{kind}"}}').type for kind in ("pause", "resume", "stop")]


@pytest.mark.parametrize(
    "wrong",
    [
        "",
        "null",
        "[]",
        "{}",
        "[" * 4000,
        '{"type":"start","type2":1}',
        '{"type":"start","prompt":""}',
        '{"type":"start","prompt":"   "}',
        '{"type":"start","prompt":"' + "x" * 513 + '"}',
        '{"type":"start","prompt":"a\\u0000b"}',
        '{"type":"start","prompt":"a\\u009bb"}',
        '{"type":"start","prompt":"a\\u007fb"}',
        '{"type":"start","prompt":"a\\ud800b"}',
        '{"type":"start","seed":-1}',
        '{"type":"start","seed":1.5}',
        '{"type":"start","seed":"7"}',
        '{"type":"start","seed":true}',
        '{"type":"start","seed":9223372036854775808}',
        '{"type":"start","seed":' + "9" * 3000 + "}",
        '{"type":"start","guidance":NaN}',
        '{"type":"start","guidance":1e999}',
        '{"type":"start","buffer":0.4}',
        '{"type":"start","buffer":11}',
        '{"type":"start","commit":-1}',
        '{"type":"prompt"}',
        '{"type":"prompt","text":7}',
        '{"type":"played","frame":-1}',
        '{"type":"played","frame":"1"}',
        '{"type":"stop","now":true}',
        '{"type":"__class__"}',
    ],
    ids=lambda text: text[:40],
)
def test_everything_else_is_refused_in_one_line(wrong):
    with pytest.raises(ValueError, match=r"^.{1,600}$") as error:
        read_message(wrong)
    str(error.value).encode()


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ("x", "what was sent is no JSON"),
        ("{}", "a message has a type; choose one of start, prompt"),
        ('{"type":"strat"}', "there is no message 'strat'; choose one of start, prompt"),
        ('{"type":"start","x":1}', "start.x: there is no such field; leave it out"),
        ('{"type":"start","seed":-4}', "start.seed: -4 should be greater than or equal to 0"),
        ('{"type":"start","seed":"' + "7" * 99 + '"}', 'start.seed: "' + "7" * 39 + "… should be a valid integer"),
        ('{"type":"prompt"}', "prompt.text: this is missing"),
        ('{"type":"prompt","text":""}', "prompt.text: this is empty"),
        ('{"type":"prompt","text":"' + "x" * 600 + '"}', "600 characters are more than the limit of 512"),
    ],
    ids=lambda text: text[:40],
)
def test_a_refusal_names_the_value_and_the_limit(wrong, words):
    with pytest.raises(ValueError, match=re.escape(words)):
        read_message(wrong)


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.integers() | st.text(),
        lambda x: st.lists(x) | st.dictionaries(st.text(), x),
    )
)
@settings(max_examples=200, deadline=None)
def test_any_json_is_a_message_or_an_error(value):
    try:
        read_message(json.dumps(value))
    except ValueError as error:
        str(error).encode()


@given(st.text(max_size=100))
def test_a_prompt_is_one_line_without_control_characters(text):
    try:
        said = plain(text)
    except ValueError:
        return
    assert said == " ".join(said.split())
    assert said.isprintable() or not any(ord(c) < 32 or 127 <= ord(c) < 160 for c in said)
    assert plain(said) == said
    said.encode()


def test_a_script_is_a_prompt_like_any_other():
    assert plain("<script>alert(1)</script>") == "<script>alert(1)</script>"


def test_a_body_is_strict():
    assert GenerateBody.model_validate({"prompts": [{"text": "walk"}]}).format == "json"
    for wrong in ({}, {"prompts": []}, {"prompts": ["walk"]}, {"prompts": [{"text": "w"}] * 9}):
        with pytest.raises(ValueError, match="prompts"):
            GenerateBody.model_validate(wrong)
    for field, value in {"num": 9, "steps": 0, "fps": 241, "loop": 1, "path": "/etc", "seconds": 3}.items():
        with pytest.raises(ValueError, match=field):
            GenerateBody.model_validate({"prompts": [{"text": "walk"}], field: value})
