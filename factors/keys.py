"""GTSAM keys in words."""

_INDEX_BITS = 56
_LABEL_BITS = 48


def readable_key(key: int) -> str:
    """ "o3" or "x12" for symbols, "xA3" for GTSAM's labelled symbols, "42" for plain integers.

    GTSAM's own formatter fails on integers whose first byte is no ASCII character.
    """
    letter, label = chr(key >> _INDEX_BITS), chr((key >> _LABEL_BITS) & 0xFF)
    if not (letter.isascii() and letter.isalpha()):
        return str(key)
    if label.isascii() and label.isalpha():
        return f"{letter}{label}{key & ((1 << _LABEL_BITS) - 1)}"
    return f"{letter}{key & ((1 << _INDEX_BITS) - 1)}"
