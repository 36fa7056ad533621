//! Opens and creates files where other users may have prepared something: never blocks on a pipe,
//! never follows another user's link.

use rustix::fs::{Mode, OFlags};
use std::fs::{DirBuilder, File, FileType, Permissions};
use std::io::{self, Read};
use std::os::unix::fs::{DirBuilderExt, FileTypeExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// How many names are tried for a temporary folder.
const TRIES: u32 = 100;

/// The kind of a file, in words.
#[must_use]
pub fn kind_of(file: FileType) -> &'static str {
    match file {
        f if f.is_file() => "a file",
        f if f.is_dir() => "a folder",
        f if f.is_fifo() => "a named pipe",
        f if f.is_socket() => "a socket",
        f if f.is_block_device() || f.is_char_device() => "a device",
        _ => "no file",
    }
}

/// Opens a regular file for reading. Anything else is refused at once: opening a named pipe would
/// wait for its other end, and a device may be endless.
///
/// # Errors
/// The system's error; [`io::ErrorKind::InvalidInput`] for anything but a file.
pub fn open_regular(path: &Path) -> io::Result<File> {
    // Non-blocking, which has no effect on regular files, and without acquiring a controlling
    // terminal.
    let flags = OFlags::RDONLY | OFlags::CLOEXEC | OFlags::NONBLOCK | OFlags::NOCTTY;
    let file = File::from(rustix::fs::open(path, flags, Mode::empty())?);
    let kind = file.metadata()?.file_type();
    if kind.is_file() {
        return Ok(file);
    }
    Err(io::Error::new(io::ErrorKind::InvalidInput, format!("it is {}, expected a regular file", kind_of(kind))))
}

/// The bytes of a regular file that has at most `most`.
///
/// # Errors
/// What the system says; [`io::ErrorKind::InvalidInput`] for what is not a file,
/// [`io::ErrorKind::InvalidData`] for one that is larger.
pub fn read_bounded(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let mut file = open_regular(path)?.take(most.saturating_add(1));
    let mut bytes = Vec::new();
    if file.read_to_end(&mut bytes)? as u64 > most {
        return Err(io::Error::new(io::ErrorKind::InvalidData, format!("it has more than {most} bytes")));
    }
    Ok(bytes)
}

/// Creates a new private folder (0700) in the folder for temporary files; its name begins with
/// `prefix`.
///
/// # Errors
/// What the system says.
pub fn temporary_folder(prefix: &str) -> io::Result<PathBuf> {
    let parent = std::env::temp_dir();
    for _ in 0..TRIES {
        let path = parent.join(format!("{prefix}-{:016x}", random()));
        // Creating a folder never follows a link, and fails if the name exists.
        match DirBuilder::new().mode(0o700).create(&path) {
            Ok(()) => return Ok(path),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
    }
    Err(io::Error::new(io::ErrorKind::AlreadyExists, "all names for a temporary folder are taken"))
}

/// A random number. (The standard library seeds each of its hashers anew.)
#[must_use]
pub fn random() -> u64 {
    use std::hash::{BuildHasher, Hasher};
    std::collections::hash_map::RandomState::new().build_hasher().finish()
}

/// Makes sure that a folder exists and is private to the user: creates it, with missing parents, or
/// makes it private (0700) if it belongs to this user.
///
/// # Errors
/// The system's error; [`io::ErrorKind::PermissionDenied`] for a folder of another user.
pub fn private_folder(path: &Path) -> io::Result<()> {
    claim(path, |_| true)
}

/// [`private_folder`] for a folder that the user names and that may contain other files: it is made
/// private only when it contains nothing but `own_names`. Otherwise its mode is not changed.
///
/// # Errors
/// The system's error; [`io::ErrorKind::PermissionDenied`] for a folder of another user, or one
/// that others can write to.
pub fn claim_folder(path: &Path, own_names: &[&str]) -> io::Result<()> {
    let is_own = |entry: io::Result<std::fs::DirEntry>| {
        entry.is_ok_and(|entry| own_names.iter().any(|name| entry.file_name() == *name))
    };
    claim(path, |path| std::fs::read_dir(path).is_ok_and(|mut entries| entries.all(is_own)))
}

fn claim(path: &Path, may_change: impl Fn(&Path) -> bool) -> io::Result<()> {
    DirBuilder::new().mode(0o700).recursive(true).create(path)?;
    // Follows links, because a cache may lie on another disk. What counts is the target.
    let about = std::fs::metadata(path)?;
    let refused = |why: String| Err(io::Error::new(io::ErrorKind::PermissionDenied, why));
    let own = rustix::process::geteuid().as_raw();
    if about.uid() != own {
        return refused(format!("the folder belongs to another user (uid {}, expected {own})", about.uid()));
    }
    let mut mode = about.mode() & 0o777;
    // On a read-only disk the mode cannot be changed, and need not be.
    if mode & 0o077 != 0 && may_change(path) && std::fs::set_permissions(path, Permissions::from_mode(0o700)).is_ok() {
        mode = 0o700;
    }
    if mode & 0o022 != 0 {
        let why =
            format!("others may write into the folder (mode {mode:03o}, expected 700; chmod 700 makes it private)");
        return refused(why);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::os::unix::net::UnixListener;

    fn mode(path: &Path) -> u32 {
        fs::metadata(path).unwrap().mode() & 0o7777
    }

    #[test]
    fn pipes_sockets_devices_and_folders_are_refused_at_once() {
        let folder = temporary_folder("tv-files").unwrap();
        let fifo = folder.join("fifo");
        rustix::fs::mknodat(rustix::fs::CWD, &fifo, rustix::fs::FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
        let socket = folder.join("socket");
        let _listener = UnixListener::bind(&socket).unwrap();
        fs::write(folder.join("file"), "x").unwrap();
        let refused = |path: &Path| open_regular(path).expect_err("no file").to_string();
        assert!(refused(&fifo).contains("named pipe"));
        assert!(refused(Path::new("/dev/zero")).contains("device"));
        assert!(refused(&folder).contains("folder"));
        // A socket cannot be opened: the system reports it.
        open_regular(&socket).unwrap_err();
        open_regular(&folder.join("file")).unwrap();
        assert_eq!(read_bounded(&folder.join("file"), 1).unwrap(), b"x");
        assert!(read_bounded(&folder.join("file"), 0).unwrap_err().to_string().contains("more than 0 bytes"));
        assert_eq!(open_regular(&folder.join("none")).unwrap_err().kind(), io::ErrorKind::NotFound);
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn folders_are_private_and_those_of_others_are_refused() {
        let folder = temporary_folder("tv-files").unwrap();
        assert_eq!(mode(&folder), 0o700);
        let deep = folder.join("a/b");
        private_folder(&deep).unwrap();
        assert_eq!([mode(&deep), mode(&folder.join("a"))], [0o700; 2]);
        let set = |mode| fs::set_permissions(&deep, Permissions::from_mode(mode)).unwrap();
        set(0o777);
        private_folder(&deep).unwrap();
        assert_eq!(mode(&deep), 0o700);
        // A folder with other files keeps its mode: it is used if others can only read it.
        fs::write(deep.join("mine"), "x").unwrap();
        set(0o777);
        claim_folder(&deep, &["mine"]).unwrap();
        assert_eq!(mode(&deep), 0o700);
        set(0o775);
        assert!(claim_folder(&deep, &[]).unwrap_err().to_string().contains("mode 775"));
        set(0o755);
        claim_folder(&deep, &[]).unwrap();
        assert_eq!(mode(&deep), 0o755);
        if rustix::process::geteuid().is_root() {
            std::os::unix::fs::chown(&deep, Some(12345), None).unwrap();
            for refused in [private_folder(&deep), claim_folder(&deep, &["mine"])] {
                assert!(refused.unwrap_err().to_string().contains("another user (uid 12345"));
            }
        }
        let file = folder.join("file");
        fs::write(&file, "x").unwrap();
        private_folder(&file).unwrap_err();
        fs::remove_dir_all(folder).unwrap();
    }
}
