#!/bin/sh
# rliable==1.2.0, arch==7.2.0, pandas==3.1.1 and 2.3.3, numpy==2.4.6, scipy==1.17.1, statsmodels==0.15.0, seaborn==0.13.2; Python 3.11, seen 2026-11-28.
# rliable 1.2.0 asks for arch below 8 and any pandas, arch 7.2.0 for any pandas from 1.4 on, so a plain installation takes pandas 3. There `import arch.bootstrap`,
# and with it `from rliable import library`, ends in "TypeError: deprecate_kwarg() missing 1 required positional argument: 'new_arg_name'": arch uses a decorator
# of pandas' own utilities, whose arguments pandas 3 changed. `pip check` finds nothing wrong. With pandas 2.3.3 the same import works. Fails if either changes.
set -eu
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
${PYTHON:-python3.11} -m venv venv
venv/bin/pip install -q --disable-pip-version-check rliable==1.2.0 arch==7.2.0 pandas==3.1.1 numpy==2.4.6 scipy==1.17.1 statsmodels==0.15.0 seaborn==0.13.2
venv/bin/pip check
if venv/bin/python -W ignore -c "from rliable import library" 2>said.txt; then echo "pandas 3.1.1: works"; exit 1; fi
tail -n 1 said.txt
grep -q "deprecate_kwarg() missing 1 required positional argument" said.txt
venv/bin/pip install -q --disable-pip-version-check pandas==2.3.3
venv/bin/python -W ignore -c "from rliable import library; print('pandas 2.3.3: works')"
