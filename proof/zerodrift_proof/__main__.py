"""`python -m zerodrift_proof FOLDER`: the same as `zerodrift-proof FOLDER`."""

import sys

from zerodrift_proof.command import main

sys.exit(main())
