"""Mark of tests that replace a method of an object, which a class compiled with mypyc does not permit."""

import pytest

from hostlink.core.protocol import session

IS_COMPILED = not str(session.__file__).endswith(".py")  # the modules of a compiled wheel (`make compiled`)

replaces_a_method = pytest.mark.skipif(IS_COMPILED, reason="the methods of a compiled class cannot be replaced")
