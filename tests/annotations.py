"""How annotations are checked at run time: by beartype, for which, as for type checkers, an int will do as a float."""

from beartype import BeartypeConf, beartype

check = beartype(conf=BeartypeConf(is_pep484_tower=True))
