import pytest

import glucoloop as gl


@pytest.fixture
def read(tmp_path):
    """Record of files with these texts or bytes."""

    def read(*contents, **asked):
        paths = []
        for number, content in enumerate(contents):
            path = tmp_path / f"export-{number}"
            path.write_bytes(content if isinstance(content, bytes) else content.encode())
            paths.append(path)
        record = gl.read_record(*paths, **asked)
        assert record.rows == record.rows_used + sum(record.left_out.values())
        return record

    return read


@pytest.fixture
def refused(read):
    """Sentence with which files are refused, without the name of the file."""

    def refused(*contents, **asked):
        with pytest.raises(gl.Refusal) as error:
            read(*contents, **asked)
        return str(error.value).partition("export-0: ")[2] or str(error.value)

    return refused
