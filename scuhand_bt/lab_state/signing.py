"""Signatures by Ed25519 (RFC 8032), with `cryptography`, an optional extra: `pip install 'scuhand-bt[sign]'`."""

from pathlib import Path

from scuhand_bt.problems import Mark, Problem, SourceError

NEEDED = "signatures need cryptography: pip install 'scuhand-bt[sign]'"


class Signer:
    """A private key; `key` is its public one, in hexadecimal digits."""

    def __init__(self, private: bytes) -> None:
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

        self._private = Ed25519PrivateKey.from_private_bytes(private)
        self.key: str = self._private.public_key().public_bytes_raw().hex()

    def sign(self, text: str) -> str:
        signature: bytes = self._private.sign(text.encode())
        return signature.hex()


def new_key(path: Path) -> str:
    """Write a new private key, for its owner's eyes only; the public one. FileExistsError for a file that is there."""
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    private = Ed25519PrivateKey.generate().private_bytes_raw()
    path.touch(0o600, exist_ok=False)
    path.write_text(private.hex() + "\n", encoding="ascii")
    return Signer(private).key


def signer_of_file(path: Path) -> Signer:
    """The signer with the key of a file. Raises SourceError for one that cannot be read or is none."""
    try:
        return Signer(bytes.fromhex(path.read_text(encoding="ascii")))
    except ModuleNotFoundError:
        raise _problem(path, NEEDED) from None
    except OSError as error:
        raise _problem(path, f"the signing key cannot be read: {error.strerror}") from None
    except ValueError:
        raise _problem(path, "this is not a signing key; `scuhand-bt ledger --new-key FILE` makes one") from None


def is_signed_by(key: str, text: str, signature: str) -> bool:
    """Whether a text was signed with the private key to this public one. Raises SourceError without `cryptography`."""
    try:
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    except ModuleNotFoundError:
        raise SourceError([Problem(Mark("the ledger", 0), f"its lines are signed, and {NEEDED}")]) from None
    try:
        Ed25519PublicKey.from_public_bytes(bytes.fromhex(key)).verify(bytes.fromhex(signature), text.encode())
    except (InvalidSignature, ValueError):
        return False
    return True


def _problem(path: Path, what: str) -> SourceError:
    return SourceError([Problem(Mark(str(path)), what)])
