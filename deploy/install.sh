#!/usr/bin/env bash
# Installs Trolley on Raspberry Pi OS, Debian or Ubuntu (64-bit); docs/install.md tells the story.
set -Eeuo pipefail
export LC_ALL=C
umask 022

usage() {
    cat <<'END'
Usage: sudo deploy/install.sh robot|pc|router [--name NAME]   install; run again: nothing changes
       sudo deploy/install.sh --upgrade                       put this checkout in place of what runs
       sudo deploy/install.sh --uninstall [--purge]           remove; --purge: settings and state, too

  robot    all that a robot needs: router, base, localizer, mapper, planner, tour
  pc       router and viewer
  router   only the router that connects a house's robots and PCs

  --name NAME  the robot's name in a new robot.toml (a-z, 0-9, _ and -)
  --dry-run    only say what would be done
  --root DIR   install below DIR instead of / (for tests: the user is still this system's)
END
}

say() { printf '%s\n' "$*"; }
warn() { printf '%s\n' "$*" >&2; }
die() { warn "$*"; exit 1; }

# Does something, or says what it would do; what was done is counted.
changes=0
run() {
    changes=$((changes + 1))
    if ((dry)); then say "would run: $*"; else "$@"; fi
}

# ---- what was asked ------------------------------------------------------------------------------

action=install role="" dry=0 purge=0 root="" name=trolley
while (($#)); do
    case $1 in
        robot | pc | router) role=$1 ;;
        --upgrade) action=upgrade ;;
        --uninstall) action=uninstall ;;
        --purge) purge=1 ;;
        --dry-run) dry=1 ;;
        --name) name=${2:?--name needs a name}; shift ;;
        --root) root=$(realpath -m "${2:?--root needs a folder}"); shift ;;
        -h | --help) usage; exit 0 ;;
        *) usage >&2; die "Unknown option '$1'." ;;
    esac
    shift
done
[[ $name =~ ^[a-z0-9_-]{1,32}$ ]] || die "A robot's name is 1 to 32 characters of a-z, 0-9, _ and -, not '$name'."
((purge)) && [[ $action != uninstall ]] && die "--purge goes with --uninstall."

checkout=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
opt=$root/opt/trolley etc=$root/etc/trolley state=$root/var/lib/trolley
cache=$root/var/cache/trolley backups=$root/var/backups/trolley
units=$root/etc/systemd/system rules=$root/etc/udev/rules.d/99-trolley.rules
command_link=$root/usr/local/bin/trolley
patience_s=${TROLLEY_INSTALL_PATIENCE_S:-180} pause_s=${TROLLEY_INSTALL_PAUSE_S:-2}

systemd() { if [[ -n $root ]]; then systemctl --root="$root" "$@"; else systemctl "$@"; fi; }
is_booted() { [[ -d $root/run/systemd/system ]]; }

trolley() { env TROLLEY_CONFIG="$etc/robot.toml" "$opt/current/.venv/bin/trolley" "$@"; }
# A backup is made and put back by the newer of two releases: the older may not know how.
trolley_of() { env TROLLEY_CONFIG="$etc/robot.toml" "$opt/releases/$1/.venv/bin/trolley" "${@:2}"; }

# Points a link to something else in one step: whoever looks sees the old or the new, never neither.
link() {
    local to=$1 path=$2
    [[ $(readlink "$path" || true) == "$to" ]] && return
    run mkdir -p "$(dirname "$path")"
    run ln -sfn "$to" "$path.new"
    run mv -T "$path.new" "$path"
}

# Writes a small file whole or not at all.
write() {
    local path=$1 text=$2
    [[ -f $path && $(<"$path") == "$text" ]] && return
    changes=$((changes + 1))
    if ((dry)); then say "would write: $path"; return; fi
    printf '%s\n' "$text" > "$path.new"
    sync "$path.new"
    mv -T "$path.new" "$path"
}

# ---- is this a machine for it? -------------------------------------------------------------------

find_python() {
    local one
    for one in python3.13 python3.12 python3.11 python3; do
        if "$one" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2> /dev/null
        then python=$one; return; fi
    done
    die "Trolley needs Python 3.11, 3.12 or 3.13. Debian 12 and 13, Raspberry Pi OS since 2023 and
Ubuntu 24.04 bring one: sudo apt install python3 python3-venv"
}

check_machine() {
    ((dry)) || [[ $(id -u) == 0 ]] || die "This changes the system: run it with sudo."
    command -v systemctl > /dev/null || die "There is no systemd here; Trolley needs it to keep its services running."
    [[ $action == uninstall ]] && return
    find_python
    [[ $("$python" -c 'import struct; print(8 * struct.calcsize("P"))') == 64 ]] || die \
        "This system is 32-bit, even if its processor is not. Trolley needs a 64-bit one (numba, which
compiles its inner loops, is not made for 32-bit ARM): write Raspberry Pi OS (64-bit) to the card."
    case $(uname -m) in
        x86_64 | aarch64) ;;
        *) die "Trolley runs on x86-64 and 64-bit ARM, not on $(uname -m)." ;;
    esac
}

check_space() {
    local folder=$opt free_mb
    while [[ ! -d $folder ]]; do folder=$(dirname "$folder"); done
    free_mb=$(df -Pm "$folder" | awk 'NR == 2 { print $4 }')
    ((free_mb >= 1200)) || die "Only $free_mb MB are free on the disk of $folder; 1200 MB are needed."
}

# ---- a release: code, environment and kernels in a folder of its own ------------------------------

list_files() {
    (cd "$checkout" && find common services deploy docs worlds requirements.lock README.md CHANGELOG.md \
        LICENSE -not -type d -not -path '*/__pycache__/*' -not -path '*.egg-info/*' -print0 | sort -z)
}

name_release() {
    local version digest
    version=$(sed -n 's/^version = "\(.*\)"$/\1/p' "$checkout/common/pyproject.toml")
    digest=$( (cd "$checkout" && list_files | xargs -0 sha256sum) | sha256sum)
    # The environment belongs to one Python: an upgrade of the system means a new one.
    release=$version-${digest:0:10}-$("$python" -c 'import sys; print("py%d.%d" % sys.version_info[:2])')
}

build_release() {
    local folder=$opt/releases/$release
    [[ -e $folder/.complete ]] && return
    check_space
    say "Installing Trolley $release ..."
    if ((dry)); then run build "$folder"; return; fi
    changes=$((changes + 1))
    rm -rf "$folder" # what an interrupted run has left
    mkdir -p "$folder"
    list_files | tar -C "$checkout" --null -T - -cf - | tar -C "$folder" --no-same-owner -xf -
    # No matter whose files the checkout holds: everybody may read them, only root may write them.
    chmod -R u=rwX,go=rX "$folder"
    make_environment "$folder"
    compile_kernels "$folder"
    sync -f "$folder"
    touch "$folder/.complete"
}

make_environment() {
    local folder=$1 members=("$1/common") one
    if ! "$python" -c 'import ensurepip, venv' 2> /dev/null; then
        say "Installing $(basename "$python")-venv with apt-get ..."
        if ! apt-get -q update ||
            ! apt-get -q install -y --no-install-recommends "$(basename "$python")-venv"
        then
            die "apt-get failed. Is there a network? Try: sudo apt install python3-venv"
        fi
    fi
    say "Making the environment (about 700 MB; some minutes on a Raspberry Pi) ..."
    "$python" -m venv "$folder/.venv"
    local bin=$folder/.venv/bin
    awk '/^[^ ]/ { wanted = /^uv==/ } wanted' "$folder/requirements.lock" > "$folder/.venv/uv.txt"
    "$python" "$folder/deploy/runtime_requirements.py" > "$folder/.venv/runtime.txt"
    "$bin/python" -m pip install --quiet --disable-pip-version-check --no-cache-dir --require-hashes \
        -r "$folder/.venv/uv.txt" || die "The packages cannot be fetched. Is this machine on the Internet?
Nothing that ran before was changed; run the same command again."
    export UV_NO_CACHE=1 UV_PYTHON_DOWNLOADS=never
    if ! "$bin/uv" pip install --quiet --python "$bin/python" --compile-bytecode --require-hashes \
        --constraint "$folder/requirements.lock" -r "$folder/.venv/runtime.txt"
    then
        # uv does not read pip's settings: where only those know the way to the packages.
        say "uv failed; trying pip, which fetches the developers' tools as well ..."
        "$bin/python" -m pip install --quiet --disable-pip-version-check --no-cache-dir \
            --require-hashes -r "$folder/requirements.lock"
    fi
    for one in "$folder"/services/*/; do members+=("$one"); done
    "$bin/uv" pip install --quiet --python "$bin/python" --offline --no-deps --no-build-isolation \
        "${members[@]/#/--editable=}"
    "$bin/python" -m pip uninstall --quiet --yes uv # 60 MB that nothing here needs again
    "$bin/python" -m compileall -q "$folder/common" "$folder/services"
}

compile_kernels() {
    local folder=$1 old=$opt/current
    # Each is named after all that it depends on, so those that did not change need no compiling.
    if [[ -d $old/common ]]; then
        (cd "$old" && find common services -name '*.nbc' -print0 | tar --null -T - -cf -) |
            tar -C "$folder" -xf -
    fi
    say "Compiling for this processor (once; a minute on a PC, perhaps ten on a Raspberry Pi) ..."
    env -u NUMBA_CACHE_DIR "$folder/.venv/bin/python" -m trolley.warmup
}

use_release() { link "releases/$1" "$opt/current"; }

# Keeps what ran and what runs now.
prune_releases() {
    local one
    for one in "$opt"/releases/*/; do
        one=$(basename "$one")
        [[ $one == "$1" || $one == "$2" ]] || run rm -rf "$opt/releases/$one"
    done
}

# Keeps the backup of this upgrade and the newest before it: each may have gigabytes.
prune_backups() {
    local one
    while IFS= read -r one; do
        run rm -f "$one"
    done < <(ls -t "$backups"/before-*.tar.gz | awk -v this="$1" '$0 != this && older++')
}

# ---- user, settings, units -----------------------------------------------------------------------

make_user() {
    if ! id -u trolley > /dev/null 2>&1; then
        run useradd --system --user-group --home-dir /var/lib/trolley --no-create-home \
            --shell /usr/sbin/nologin trolley
    fi
    # Who may use serial ports.
    if ! id -nG trolley 2> /dev/null | grep -qw dialout; then run usermod -aG dialout trolley; fi
    [[ -d $state ]] || run install -d -m 755 "$state" # systemd gives it to the user
    [[ -d $backups ]] || run install -d -m 700 "$backups"
    [[ -d $etc ]] || run install -d -m 755 "$etc"
}

# Settings are written once and never touched again.
write_settings() {
    [[ -e $etc/robot.toml ]] && return
    changes=$((changes + 1)) is_new=1
    if ((dry)); then say "would write: $etc/robot.toml (trolley init)"; return; fi
    rm -f "$etc/.robot.toml.new"
    trolley init --name "$name" "$etc/.robot.toml.new" > /dev/null
    sync "$etc/.robot.toml.new"
    mv -nT "$etc/.robot.toml.new" "$etc/robot.toml"
    say "Wrote $etc/robot.toml: every setting is explained there."
}

# Names that stay for the serial ports, once: from what is plugged in now.
find_devices() {
    local ports
    [[ $role == robot && -z $root && ! -e $rules ]] && ((is_new)) || return 0
    ports=$(compgen -G '/dev/ttyUSB*' || compgen -G '/dev/ttyACM*' || true)
    [[ -n $ports ]] || return 0
    say "Looking for the motor board and the lidar (8 s; nothing on wheels moves) ..."
    if ((dry)); then say "would run: trolley detect --write --udev $rules"; return 0; fi
    if trolley detect --write "$etc/robot.toml" --udev "$rules"; then
        changes=$((changes + 1))
        udevadm control --reload && udevadm trigger --subsystem-match=tty
    else
        rm -f "$rules"
    fi
}

install_units() {
    local source=$opt/current/deploy/systemd file list old=""
    ((dry)) && [[ ! -d $source ]] && source=$checkout/deploy/systemd
    list=$(cd "$source" && find . -type f -printf '%P\n' | sort)
    [[ ! -e $opt/units ]] || old=$(<"$opt/units")
    while IFS= read -r file; do
        cmp -s "$source/$file" "$units/$file" || run install -D -m 644 "$source/$file" "$units/$file"
    done <<< "$list"
    while IFS= read -r file; do
        [[ -z $file ]] || grep -qxF -- "$file" <<< "$list" || run rm -f "$units/$file"
    done <<< "$old"
    write "$opt/units" "$list"
}

# Makes systemd read the units, and starts or only enables them.
bring_up() {
    systemd is-enabled --quiet "trolley-$role.target" 2> /dev/null || run systemd enable --quiet "trolley-$role.target"
    if ! is_booted; then
        ((changes == 0)) || say "systemd does not run here, so nothing is started now; it will be at the next boot."
        return 0
    fi
    ((changes == 0)) || run systemd daemon-reload
    systemd is-active --quiet "trolley-$role.target" || run systemd start "trolley-$role.target"
}

# Prints why not everything is up; nothing where it is. Argument: as for wait_until_up.
what_is_missing() {
    local states status i
    mapfile -t states < <(systemd is-active "${wanted[@]}")
    for i in "${!wanted[@]}"; do
        [[ ${states[i]:-} == active ]] || { say "${wanted[i]} is ${states[i]:-unknown}"; return; }
    done
    [[ $role == robot ]] || return 0
    # 1: the robot answers but has something to complain of, as before perhaps.
    status=$(trolley status 2>&1) && return
    (($? <= $1)) || say "${status:-trolley status says nothing}"
}

# Waits until all has been up for five looks in a row; else sets `missing`. Argument: the worst exit
# code of `trolley status` that will do.
wait_until_up() {
    local deadline=$((SECONDS + patience_s)) looks=0 restarts="" now
    is_booted && ((!dry)) || return 0
    mapfile -t wanted < <(sed -n 's/^Wants=//p' "$units/trolley-$role.target" | grep -o '[^ ]*\.service')
    say "Waiting for the services ..."
    while ((looks < 5)); do
        missing=$(what_is_missing "$1")
        # One that dies again and again is active in between.
        now=$(systemd show -p NRestarts --value "${wanted[@]}")
        if [[ -z $missing && $now == "$restarts" ]]; then looks=$((looks + 1)); else looks=0; fi
        [[ -n $missing || $now == "$restarts" || -z $restarts ]] || missing="a service dies again and again"
        restarts=$now
        if [[ -n $missing ]] && ((SECONDS >= deadline)); then return 1; fi
        sleep "$pause_s"
    done
    is_up=1
    say "All services are up."
}

# ---- upgrade -------------------------------------------------------------------------------------

# A release may refuse what the one before took: that is said while the robot still runs.
check_settings() {
    local said
    [[ -e $etc/robot.toml ]] || return 0
    said=$("$opt/releases/$release/.venv/bin/python" -m trolley.config "$etc/robot.toml" 2>&1) || die \
        "Trolley $release cannot use the settings of this host:
$said
Correct that, and run this again. Nothing was changed; what ran goes on."
}

# Stops what runs, saves the state, and starts the new release; what for is written down first, so
# that a run that was cut short can be finished by the next.
upgrade() {
    local old backup worst=1
    old=$(basename "$(readlink "$opt/current")")
    build_release
    if [[ $old == "$release" ]]; then return; fi
    backup=$backups/before-$release-$(date +%Y%m%d-%H%M%S).tar.gz
    if ((dry)); then say "would switch from $old to $release, with a backup in $backup"; return; fi
    check_settings
    if [[ $role == robot ]] && is_booted && trolley status > /dev/null 2>&1; then worst=0; fi
    write "$opt/upgrading" "$old $release $backup $worst"
    if is_booted; then systemd stop "trolley-$role.target"; fi
    trolley_of "$release" backup --state "$state" "$backup" || {
        rm "$opt/upgrading"
        bring_up
        die "The state could not be saved in $backup, so $old goes on. Make room, and run this again."
    }
    switch_and_check
}

switch_and_check() {
    local old new backup worst tried unit
    read -r old new backup worst tried < "$opt/upgrading"
    use_release "$new"
    install_units
    bring_up
    if wait_until_up "$worst"; then
        rm "$opt/upgrading"
        prune_releases "$old" "$new"
        prune_backups "$backup"
        say "Trolley $new is running. The state before it: $backup"
        return
    fi
    warn "Trolley $new did not come up: $missing"
    unit=${missing%% *}
    [[ $unit == trolley-*.service ]] || unit='trolley-*'
    if is_booted; then journalctl --unit "$unit" --lines 20 --no-pager >&2 || true; fi
    warn "Going back to $old ..."
    systemd stop "trolley-$role.target"
    # New code may have changed what is saved. That is put back first: until then a run that was cut
    # short is seen by what is current.
    trolley_of "$new" restore --state "$state" --state-only "$backup" > /dev/null ||
        give_up_putting_back "$old" "$new" "$backup" "$worst" "$tried"
    use_release "$old"
    install_units
    systemd reset-failed 'trolley-*' || true
    bring_up
    rm "$opt/upgrading"
    wait_until_up 1 || die "$old does not come up either: $missing"
    die "Trolley $old is running again, with the state from before. Nothing is lost."
}

# Lets the next run put the state back, and the one after that do something else.
give_up_putting_back() {
    local old=$1 new=$2 backup=$3 worst=$4 tried=$5
    if [[ -z $tried ]]; then
        write "$opt/upgrading" "$old $new $backup $worst tried"
        die "The state could not be put back from $backup. Make room if the disk is full, and run this again."
    fi
    rm "$opt/upgrading"
    die "The state could not be put back from $backup again, so it is not tried any more: Trolley $new
stays, stopped, with the state as it is now. Upgrade to a release that comes up, or go back to $old,
which may leave out what only $new can read:
  sudo $opt/releases/$old/deploy/install.sh --upgrade
To put the state back yourself, before that: sudo trolley restore --state-only $backup"
}

# An upgrade was cut short, by a power cut perhaps.
finish_upgrade() {
    [[ -e $opt/upgrading ]] && ((!dry)) || return 0
    local old new backup worst
    read -r old new backup worst < "$opt/upgrading"
    if [[ $(readlink "$opt/current") == "releases/$new" && -e $backup ]]; then
        say "The last upgrade was cut short; finishing it."
        switch_and_check
    else
        rm "$opt/upgrading"
    fi
}

# ---- the whole -----------------------------------------------------------------------------------

install_all() {
    local installed=""
    [[ ! -e $opt/role ]] || installed=$(<"$opt/role")
    if [[ $action == upgrade ]]; then
        [[ -n $installed ]] || die "Trolley is not installed here: say what this is, robot, pc or router."
        role=${role:-$installed}
    fi
    [[ -n $role ]] || { usage >&2; die "Say what this is: robot, pc or router."; }
    [[ -z $installed || $installed == "$role" ]] ||
        die "This is installed as a $installed. To make it a $role: install.sh --uninstall (it keeps settings and state), then again."
    finish_upgrade
    name_release
    if [[ -e $opt/current && $action != upgrade ]]; then
        local current
        current=$(basename "$(readlink "$opt/current")")
        if [[ $current != "$release" ]]; then
            warn "Trolley $current runs here; this checkout holds $release. To change to it: install.sh --upgrade"
            release=$current
        fi
    fi
    make_user
    if [[ $action == upgrade ]]; then upgrade; else build_release; use_release "$release"; fi
    write_settings
    find_devices
    install_units
    link /opt/trolley/current/.venv/bin/trolley "$command_link"
    write "$opt/role" "$role"
    bring_up
    finish
}

finish() {
    if ((changes == 0)); then say "Nothing to do: Trolley $release is installed as a $role."; return; fi
    if ((dry)); then say "Nothing was done (--dry-run)."; return; fi
    ((is_up)) || wait_until_up 1 || die "It is installed, but not everything is running: $missing
What they say: journalctl -u 'trolley-*' -n 50"
    memory_note
    say "Trolley $release is installed as a $role."
    ((!is_new)) || case $role in
        robot) say "Next: plug in the motor board and the lidar, then 'sudo trolley detect --write'. Until then
the robot is a simulated one. docs/install.md continues from here." ;;
        pc) say "Next: make keys for this PC and set [zenoh] uplink in $etc/robot.toml; docs/network.md tells how." ;;
        router) say "Next: make keys for this router and copy them here; docs/network.md tells how." ;;
    esac
}

memory_note() {
    local v2=$root/sys/fs/cgroup/cgroup.controllers
    if is_booted && [[ -e $v2 ]] && ! grep -qw memory "$v2"; then
        say "Note: this system does not count memory per service, so the limits have no effect. On a
Raspberry Pi add cgroup_enable=memory to the line in /boot/firmware/cmdline.txt and reboot."
    fi
}

uninstall() {
    local one file
    for one in robot pc router; do
        [[ -e $units/trolley-$one.target ]] || continue
        if is_booted; then run systemd stop "trolley-$one.target"; fi
        run systemd disable --quiet "trolley-$one.target"
    done
    if [[ -e $opt/units ]]; then
        while IFS= read -r file; do
            # One that was enabled by hand, as the viewer on a robot.
            [[ $file != trolley-*.service || ! -e $units/$file ]] || run systemd disable --quiet "$file"
            [[ ! -e $units/$file ]] || run rm -f "$units/$file"
            [[ $file != */* || ! -d $units/${file%/*} ]] ||
                run rmdir --ignore-fail-on-non-empty "$units/${file%/*}"
        done < "$opt/units"
        if is_booted; then run systemd daemon-reload; fi
    fi
    [[ ! -L $command_link ]] || run rm -f "$command_link"
    for one in "$cache" "$opt"; do [[ ! -e $one ]] || run rm -rf "$one"; done
    if ((purge)); then
        for one in "$etc" "$state" "$backups" "$rules"; do [[ ! -e $one ]] || run rm -rf "$one"; done
        if id -u trolley > /dev/null 2>&1; then run userdel trolley; fi
    fi
    if ((changes == 0)); then say "Nothing to do: Trolley is not installed."
    elif ((dry)); then say "Nothing was done (--dry-run)."
    elif ((purge)); then say "Trolley is removed, with its settings and state."
    else say "Trolley is removed. Settings ($etc) and state ($state) are kept."; fi
}

python="" release="" missing="" is_new=0 is_up=0 wanted=()
check_machine
# Two at once would take each other's files away.
if ((!dry)); then
    mkdir -p "$root/run"
    exec 9> "$root/run/trolley-install.lock"
    flock -n 9 || die "Another install.sh is running."
    trap 'warn "This failed (line $LINENO). Running it again repairs whatever is half done."' ERR
fi
if [[ $action == uninstall ]]; then uninstall; else install_all; fi
