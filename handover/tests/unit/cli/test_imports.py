"""A command starts without importing what only services need."""

import subprocess
import sys


def test_a_command_does_not_import_the_web_framework_or_the_database() -> None:
    code = (
        "import sys, handover.command_line.main; print({'fastapi', 'sqlalchemy', 'numpy'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
