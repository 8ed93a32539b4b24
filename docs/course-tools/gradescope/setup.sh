#!/usr/bin/env bash
# Gradescope runs this once, as root, when it builds the autograder's image.
set -euo pipefail
source=${PENUMBRA_AUTOGRADER:-/autograder}/source
home=${PENUMBRA_HOME:-/opt/penumbra}

wheels=("$source"/penumbra-*.whl)
if [ ! -f "${wheels[0]}" ]; then
    echo "setup: no penumbra-*.whl beside setup.sh: put the one that \`make wheel\` builds there" >&2
    exit 2
fi

# Penumbra needs Python 3.11; Ubuntu 22.04 calls an older one python3, and has that too.
python=python3
python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))' || python=python3.11

# bubblewrap is the cage that submitted programs run in; build-essential builds them.
apt-get update
apt-get install -y --no-install-recommends "$python" "$python-venv" bubblewrap build-essential

"$python" -m venv "$home"
"$home/bin/pip" install --no-cache-dir "${wheels[0]}"
