#!/bin/sh
# Chromium, as tests start it: without the right to raise its priority. As root it would raise that of the process
# which draws, and without a graphics card that process needs a core: the services and tests beside it would starve.
program=$(command -v chromium || command -v google-chrome)
if setpriv --bounding-set -sys_nice true 2>/dev/null; then
  exec setpriv --bounding-set -sys_nice "$program" "$@"
fi
exec "$program" "$@"
