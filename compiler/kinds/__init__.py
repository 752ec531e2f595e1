"""The form in which a kind declares its keys, its checks and what is drawn of it."""

from scenec.compiler.kinds import forms
from scenec.compiler.kinds.context import Array, Context, InputFile
from scenec.compiler.kinds.declare import Form, bounded, given, key, noise_key
from scenec.compiler.kinds.draw import draw_kind, draw_object
from scenec.compiler.kinds.finding import Finding
from scenec.compiler.kinds.forms import an, file, list_of, named, one_of, word_or
from scenec.compiler.kinds.node import Node, black, is_black, off_terrain, unknown
from scenec.compiler.kinds.table import kind_of

__all__ = [
    "Array", "Context", "Finding", "Form", "InputFile", "Node", "an", "black", "bounded",
    "draw_kind", "draw_object", "file", "forms", "given", "is_black", "key", "kind_of", "list_of",
    "named", "noise_key", "off_terrain", "one_of", "unknown", "word_or",
]  # fmt: skip
