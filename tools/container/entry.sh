#!/bin/sh
# Process 1 of the container. When process 1 ends, the kernel kills everything else in the container at once, the guardian too:
# so it outlives a daemon that was killed by the second in which the guardian stops the robots, and any daemon by the
# time in which incidents are written out of the memory that it has left.
hostlink "$@" &
daemon=$!
trap 'kill -TERM "$daemon"' TERM INT HUP
trap 'kill -USR1 "$daemon"' USR1
while :; do
  wait "$daemon"
  status=$?
  kill -0 "$daemon" 2>/dev/null || break # else a signal came, and was passed on
done
[ "$status" -gt 128 ] && sleep 1
for _ in $(seq 40); do
  set -- /dev/shm/hostlink-*-"$daemon"-*
  [ -e "$1" ] || break
  sleep 0.5
done
exit "$status"
