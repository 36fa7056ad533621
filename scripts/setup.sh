#!/usr/bin/env bash
# Installs what TerraVision needs and this machine lacks: Debian 12, Ubuntu 24.04 and their like. Asks nothing, says what
# and why. With --tests also what only the tests need, with --servers what scripts/servers.sh does.
set -euo pipefail

readonly MSRV=1.89
# rustup's folder is not on the path of a shell that was there before it; callers extend theirs in the same way.
PATH=$PATH:$HOME/.cargo/bin

say() { printf 'setup: %s\n' "$*" >&2; }

# What is needed: the package, a test that is true when it is there, and why.
missing=()
need() {
  local package=$1 why=$2
  shift 2
  if ! "$@" >/dev/null 2>&1; then
    say "$package is missing: $why"
    missing+=("$package")
  fi
}

# Any Python will do; the tests look for one in the same places.
has_python_module() { python3 -c "import $1" || /usr/bin/python3 -c "import $1"; }
has_library() { grep -q "$1" <<<"$(ldconfig -p)"; }
has_vulkan_driver() {
  # Any driver will do: one of a GPU, or the software device of Mesa.
  compgen -G '/usr/share/vulkan/icd.d/*.json' || compgen -G '/etc/vulkan/icd.d/*.json' || [[ -n ${VK_ICD_FILENAMES:-}${VK_DRIVER_FILES:-} ]]
}
has_validation_layer() {
  compgen -G '/usr/share/vulkan/explicit_layer.d/*validation*.json' || compgen -G '/etc/vulkan/explicit_layer.d/*validation*.json'
}

check_packages() {
  # ldconfig is not on every user's path.
  PATH=$PATH:/usr/sbin:/sbin
  need build-essential 'compiles and links (zstd is C)' command -v cc
  if ! is_rust_new_enough && [[ ! -x $HOME/.cargo/bin/cargo ]]; then
    need curl 'fetches Rust, which is missing or too old' command -v curl
    need ca-certificates 'fetches Rust, which is missing or too old' test -e /etc/ssl/certs/ca-certificates.crt
  fi
  need pkg-config 'finds libraries when TerraVision is built' command -v pkg-config
  need libgdal-dev 'reads rasters of all kinds (ingest)' pkg-config --exists gdal
  need libturbojpeg0-dev 'encodes pictures for browsers (viewer)' pkg-config --exists libturbojpeg
  need libvulkan1 'the Vulkan loader (renderer)' has_library 'libvulkan\.so\.1'
  need mesa-vulkan-drivers 'a Vulkan device without a GPU: lavapipe (renderer)' has_vulkan_driver
  need ffmpeg 'makes films (fly -o film.mp4)' command -v ffmpeg
  if [[ $1 == tests || $1 == servers ]]; then
    need python3-venv 'an S3 server' python3 -c 'import venv, ensurepip'
  fi
  if [[ $1 == servers ]]; then
    need curl 'fills an S3 bucket' command -v curl
  fi
  if [[ $1 == tests ]]; then
    need gdal-bin 'crops a raster of the whole globe (tests of real data)' command -v gdal_translate
    need vulkan-validationlayers 'checks every use of Vulkan in the tests' has_validation_layer
    need xvfb 'a screen that nobody sees, for the tests of the window' command -v Xvfb
    need weston 'a desktop of Wayland that nobody sees, for the tests of the window' command -v weston
    need libxcursor1 'the window (tests)' has_library 'libXcursor\.so\.1'
    need libxi6 'the window (tests)' has_library 'libXi\.so\.6'
    need libwayland-client0 'the window (tests)' has_library 'libwayland-client\.so\.0'
    need libxkbcommon-x11-0 'the window (tests)' has_library 'libxkbcommon-x11\.so\.0'
    need python3-numpy 'reads and steers flights from Python (examples)' has_python_module numpy
    need python3-pil 'saves what flights from Python see (examples)' has_python_module PIL
  fi
}

install_packages() {
  local as_root=()
  if [[ $(id -u) -ne 0 ]]; then
    as_root=(sudo -n)
    if ! command -v sudo >/dev/null || ! sudo -n true 2>/dev/null; then
      say "not root, and sudo would ask: run  apt-get install -y --no-install-recommends ${missing[*]}  as root, then again"
      exit 1
    fi
  fi
  if ! command -v apt-get >/dev/null; then
    say "no apt-get here: install by hand what your system calls ${missing[*]}"
    exit 1
  fi
  say "installing ${missing[*]}"
  "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get update -qq >&2
  "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >&2
}

is_rust_new_enough() {
  command -v cargo >/dev/null && command -v rustc >/dev/null || return 1
  local found
  found=$(rustc --version | awk '{ print $2 }')
  [[ $(printf '%s\n%s\n' "$MSRV" "$found" | sort -V | head -n 1) == "$MSRV" ]]
}

# Debian 12 and Ubuntu 24.04 package a Rust that is too old, so it comes from rustup, into the user's home alone.
check_rust() {
  is_rust_new_enough && return
  if command -v rustup >/dev/null; then
    say "Rust is older than $MSRV: rustup fetches the stable one"
    rustup toolchain install stable --profile minimal --no-self-update >&2
    rustup default stable >&2
  else
    say "Rust $MSRV or newer is missing: rustup installs it under $HOME (cargo builds everything here)"
    curl --proto '=https' --tlsv1.2 -sSf https://sh.rustup.rs | sh -s -- -y --profile minimal >&2
  fi
  PATH=$HOME/.cargo/bin:$PATH
  hash -r
  if ! is_rust_new_enough; then
    say "Rust is still older than $MSRV; is another one before $HOME/.cargo/bin on PATH?"
    exit 1
  fi
}

# A web server, unpacked beside what cargo builds: an installed one would be started by the system.
unpack_nginx() {
  local folder=${CARGO_TARGET_DIR:-$(dirname "${BASH_SOURCE[0]}")/../target}/nginx
  PATH=$PATH:/usr/sbin command -v nginx >/dev/null || [[ -x $folder/usr/sbin/nginx ]] && return
  say "nginx is missing: a web server, in $folder"
  mkdir -p "$folder"
  (cd "$folder" && apt-get download -qq nginx >&2 && dpkg-deb -x nginx_*.deb . && rm nginx_*.deb)
}

# An S3 server of Python, for the tests of buckets: in a folder of its own, beside what cargo builds.
install_s3_server() {
  local folder=${CARGO_TARGET_DIR:-$(dirname "${BASH_SOURCE[0]}")/../target}/s3-server
  [[ -x $folder/bin/moto_server ]] && return
  say "moto is missing: an S3 server, in $folder"
  python3 -m venv "$folder" >&2
  "$folder/bin/pip" install --quiet --disable-pip-version-check 'moto[s3,server]==5.2.5' >&2
}

# A browser and node, for the tests of the viewer's page. Not every system has a Chromium that runs without a desktop, and the
# other tests need none.
install_browser() {
  local packages=()
  command -v node >/dev/null || packages+=(nodejs)
  command -v npm >/dev/null || packages+=(npm)
  command -v chromium >/dev/null || command -v chromium-browser >/dev/null || packages+=(chromium)
  ((${#packages[@]} == 0)) && return
  local package
  for package in "${packages[@]}"; do
    say "$package is missing: tests the viewer's page in a browser"
    if ! grep -q '^  Candidate: [0-9]' <<<"$(apt-cache policy "$package" 2>/dev/null)"; then
      say "no package $package here"
      return 1
    fi
  done
  missing=("${packages[@]}")
  install_packages
}

main() {
  local purpose=flights
  case ${1:-} in
    '') ;;
    --tests) purpose=tests ;;
    --servers) purpose=servers ;;
    *)
      say "usage: scripts/setup.sh [--tests|--servers]"
      exit 2
      ;;
  esac
  check_packages "$purpose"
  if ((${#missing[@]} > 0)); then
    install_packages
    missing=()
    check_packages "$purpose"
    if ((${#missing[@]} > 0)); then
      say "still missing after the installation: ${missing[*]}"
      exit 1
    fi
  fi
  check_rust
  if [[ $purpose == servers ]]; then
    unpack_nginx
    install_s3_server
  elif [[ $purpose == tests ]]; then
    # Without it the tests of buckets say so and pass.
    install_s3_server || say 'moto cannot be installed: the tests of S3 buckets are skipped'
    (install_browser) || say "no browser: the tests of the viewer's page are skipped"
  fi
}

main "$@"
