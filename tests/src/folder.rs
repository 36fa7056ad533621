//! A folder of a test's own, removed at the end.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// A new folder under the target folder, removed when dropped (unless the test failed: then it is
/// evidence).
#[derive(Debug)]
pub struct TestFolder {
    path: PathBuf,
}

impl TestFolder {
    /// A folder for the test of this name.
    ///
    /// # Panics
    /// When it cannot be made.
    #[must_use]
    pub fn new(test: &str) -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        // Relaxed: the count orders nothing, it only has to differ.
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let path = target_tmp().join(format!("{test}-{}-{number}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        Self { path }
    }

    /// Its path.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The path of something in it.
    #[must_use]
    pub fn join(&self, name: impl AsRef<Path>) -> PathBuf {
        self.path.join(name)
    }
}

impl Drop for TestFolder {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            // What cannot be removed is rubbish in a build folder, no failure.
            drop(std::fs::remove_dir_all(&self.path));
        }
    }
}

/// Folder for what tests write: `tmp` in the target folder.
///
/// # Panics
/// When it cannot be made.
#[must_use]
pub fn target_tmp() -> PathBuf {
    let test = std::env::current_exe().expect("a test knows its own path");
    let target = test.ancestors().nth(3).expect("cargo puts tests into target/PROFILE/deps");
    let folder = target.join("tmp");
    std::fs::create_dir_all(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    folder
}
