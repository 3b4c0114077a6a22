# shellcheck shell=bash
# Takes a ROS domain that no other demo, test or measurement of this machine has, until this process and its children end:
# $ROS_DOMAIN_ID. The locks are those of src/node/own_domain.rs. Source it.

for domain in {1..101}; do
    domain=$(((($$ * 7 + domain) % 101) + 1))
    # Another user's lock can't be opened.
    { exec {lock}>"${TMPDIR:-/tmp}/egotac-ros-domain-$domain.lock"; } 2>/dev/null || continue
    if flock --nonblock "$lock"; then
        break
    fi
    exec {lock}>&-
done
# If all are taken, the last one is shared.
export ROS_DOMAIN_ID=$domain
