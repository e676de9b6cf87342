"""Write JSON files, and read them: each must match its schema; errors name the file, the key and the cure."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import from_json

from morphofold.digests_and_json import Row, strict_json
from morphofold.errors import DamagedFile, NotReadable, TooLarge
from morphofold.io.files import check_fetched, write_text

MOST_JSON_BYTES = 64 * 2**20  # bytes; the gyral graph of a hemisphere of a million vertices needs a tenth of it
LARGEST_NUMBER = 1e12  # largest number of a surface: beyond it, squares and sums lose their meaning

Number = Annotated[float, Field(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER)]
Amount = Annotated[float, Field(ge=0, le=LARGEST_NUMBER)]
Length = Annotated[float, Field(ge=1e-9, le=LARGEST_NUMBER)]
Count = Annotated[int, Field(ge=0, le=10**12)]
Index = Annotated[int, Field(ge=-(10**12), le=10**12)]


def file_word(name: str) -> str:
    """The name of a map or annotation; raises ``NotReadable`` if it cannot be part of a file name."""
    if not name or not all(c.isalnum() or c in "-_." for c in name) or name.startswith(".") or name.endswith(".gii"):
        raise NotReadable(f"{name!r} cannot be part of a file name. Use letters, digits, '-', '_' and '.'.")
    return name


FileWord = Annotated[str, AfterValidator(file_word)]


class Record(BaseModel):
    """The keys that a JSON object must hold; other keys are allowed and may hold anything."""

    model_config = ConfigDict(strict=True, extra="allow", allow_inf_nan=False)


def write_json(path: Path, content: Any) -> None:
    """Write strict JSON, completely or not at all."""
    write_text(path, strict_json(content))


def read_json(path: Path, schema: type[BaseModel], cure: str) -> Row:
    """Content of a JSON object that matches the schema.

    Raises
    ------
    FileNotFoundError, ValueError
        If the file does not exist, or a value in it is of another type, NaN, infinite or out of range; the message
        names the file and the key, and ends with the cure.
    """
    check_fetched(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: is missing. {cure}")
    n_bytes = path.stat().st_size
    if n_bytes > MOST_JSON_BYTES:
        raise TooLarge(f"{path}: has {n_bytes:,} bytes; at most {MOST_JSON_BYTES:,} are allowed. {cure}")
    try:
        content: Row = from_json(path.read_bytes(), allow_inf_nan=False)
        schema.model_validate(content)
    except ValidationError as error:
        problem = error.errors(include_url=False, include_context=False)[0]
        key = ".".join(map(str, problem["loc"])) or "the whole"
        got_text = "" if problem["type"] == "missing" else f", got {problem['input']!r:.40}"
        message = problem["msg"].removeprefix("Value error, ").removesuffix(".")
        raise NotReadable(f"{path}: {key}: {message[:1].lower()}{message[1:]}{got_text}. {cure}") from None
    except ValueError as error:
        raise DamagedFile(f"{path}: is not JSON ({error}). {cure}") from None
    return content
