"""What docs/your_own_world.md shows, done."""

import re
import shlex
from pathlib import Path

import pytest

from zebrat_bullet.cli import main

PAGE = Path(__file__).parent.parent / "docs" / "your_own_world.md"
BLOCK = re.compile(r"(?:`([\w.]+)`:\n\n)?```(python|yaml|sh)\n(.*?)```", re.DOTALL)
REFUSED = "# refused"


@pytest.mark.timeout(900)  # a dozen commands, processes of their own: over 300 s beside other work
def test_the_page_on_worlds_of_ones_own_does_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    done = []
    for name, language, text in BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        if language == "yaml":
            Path(name).write_text(text, encoding="utf-8")
        elif language == "python":
            exec(text, {})
        else:
            for line in text.splitlines():
                expected = 2 if REFUSED in line else 0
                words = shlex.split(line, comments=True)[1:]
                words += ["--workers", "1"] if words[0] == "evaluate" else []
                assert main([*words, "--quiet"]) == expected, line
                said = capsys.readouterr()
                done.append(line)
                if expected:
                    assert "It would stand free at (" in said.err
                if "oracle" in words:
                    assert "100%" in (Path(words[words.index("--out") + 1]) / "table.md").read_text(encoding="utf-8")
    assert len(done) >= 9
    for picture in ("look.png", "corridor.png", "room.png", "circuit.png"):
        assert Path(picture).stat().st_size > 5000
