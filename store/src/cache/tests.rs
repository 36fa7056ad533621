//! The disk cache alone: entries, bound, sharing, damage.

use super::*;
use std::fs::File;
use std::sync::atomic::AtomicU32;

/// As databases are named.
const NAME: &str = "0123456789abcdef0123456789abcdef";

struct Folder(PathBuf);

impl Folder {
    fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("tv-cache-{}-{number}", std::process::id()));
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn open(&self, most_bytes: u64) -> DiskCache {
        DiskCache::open(&self.0, NAME, most_bytes, Arc::default())
    }

    /// Bytes of all entries, while no process writes.
    fn bytes(&self) -> u64 {
        let gate = sweep::open_gate(&self.0).unwrap();
        gate.lock().unwrap();
        fn below(folder: &Path) -> u64 {
            let entries = fs::read_dir(folder).into_iter().flatten().flatten();
            entries
                .map(|entry| match entry.metadata() {
                    Ok(about) if about.is_dir() => below(&entry.path()),
                    Ok(about) => about.len().div_ceil(BLOCK_BYTES) * BLOCK_BYTES,
                    Err(_) => 0,
                })
                .sum()
        }
        below(&self.0.join("tiles"))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        fs::remove_dir_all(&self.0).ok();
    }
}

fn key(number: u64) -> Key {
    Key { file: "color", range: number * 10_000..(number + 1) * 10_000 }
}

fn content(number: u64) -> Vec<u8> {
    (0..10_000u64).map(|k| (k * 7 + number) as u8).collect()
}

#[test]
fn what_was_kept_is_read_again_by_another_process_too() {
    let folder = Folder::new();
    let cache = folder.open(1 << 20);
    assert_eq!(cache.get(&key(1)), None);
    cache.put(&key(1), &content(1));
    for cache in [&cache, &folder.open(1 << 20)] {
        assert_eq!(cache.get(&key(1)).as_deref(), Some(content(1).as_slice()));
        assert_eq!(cache.get(&Key { file: "elevation", ..key(1) }), None);
    }
    assert_eq!(cache.stats(), CacheStats { hits: 1, bytes: 10_000, misses: 2, written: 1, damaged: 0 });
    assert_eq!(
        DiskCache::open(&folder.0, "fedcba9876543210fedcba9876543210", 1 << 20, Arc::default()).get(&key(1)),
        None
    );
}

/// Pieces are large, so that all users write at one time.
#[test]
fn users_within_one_process_do_not_write_into_each_others_files() {
    const BYTES: u64 = 1 << 20;
    for round in 0..20u8 {
        let folder = Folder::new();
        let caches: [_; 6] = std::array::from_fn(|_| folder.open(64 * BYTES));
        let start = std::sync::Barrier::new(caches.len());
        let (key, content) = (Key { file: "color", range: 0..BYTES }, vec![round; BYTES as usize]);
        std::thread::scope(|scope| {
            for cache in &caches {
                scope.spawn(|| {
                    start.wait();
                    cache.put(&key, &content);
                });
            }
        });
        assert!(caches.iter().all(|cache| !cache.is_paused()), "round {round}");
        assert_eq!(caches[0].get(&key).as_deref(), Some(&content[..]));
    }
}

#[test]
fn the_bound_holds_with_several_users_and_the_longest_unused_goes() {
    let folder = Folder::new();
    let most = 40 * disk_bytes(10_000);
    let caches = [folder.open(most), folder.open(most), folder.open(most)];
    std::thread::scope(|scope| {
        for (user, cache) in caches.iter().enumerate() {
            let folder = &folder;
            scope.spawn(move || {
                for number in 0..200u64 {
                    // Some entries are shared by all.
                    let number = if number % 3 == 0 { number } else { number + 1000 * user as u64 };
                    cache.put(&key(number), &content(number));
                    assert!(folder.bytes() <= most, "{} bytes of at most {most}", folder.bytes());
                    if let Some(read) = cache.get(&key(number)) {
                        assert_eq!(read, content(number));
                    }
                }
            });
        }
    });
    assert!(folder.bytes() > most / 2, "it keeps what it may: {} of {most}", folder.bytes());

    // Ages are whole seconds; entry 7 is the oldest, 9 the youngest.
    let folder = Folder::new();
    let cache = folder.open(most);
    for number in 0..40 {
        cache.put(&key(number), &content(number));
        let age = if number == 7 { 5000 } else { 4000 - 10 * number };
        let modified = SystemTime::now() - Duration::from_secs(age);
        let file = File::open(cache.path(&key(number))).unwrap();
        file.set_times(FileTimes::new().set_modified(modified)).unwrap();
    }
    assert!(cache.get(&key(7)).is_some(), "used just now");
    cache.put(&key(100), &content(100));
    assert!(cache.get(&key(100)).is_some(), "room was made");
    assert!(cache.get(&key(7)).is_some(), "it was used last");
    assert!(cache.get(&key(0)).is_none() && cache.get(&key(1)).is_none(), "they were not used for longest");
    assert!(cache.get(&key(39)).is_some());
}

#[test]
fn damaged_entries_are_removed_and_noted_once() {
    let folder = Folder::new();
    let log = Arc::new(ErrorLog::default());
    let cache = DiskCache::open(&folder.0, NAME, 1 << 20, Arc::clone(&log));
    for (number, change) in [0usize, 5, 100, 10_007].into_iter().enumerate() {
        let key = key(number as u64);
        cache.put(&key, &content(1));
        let path = cache.path(&key);
        let mut bytes = fs::read(&path).unwrap();
        bytes[change] ^= 1;
        fs::write(&path, &bytes).unwrap();
        assert_eq!(cache.get(&key), None);
        assert!(!path.exists());
        cache.put(&key, &content(1));
        fs::write(&path, &bytes[..change]).unwrap();
        assert_eq!(cache.get(&key), None, "cut short");
    }
    assert_eq!(cache.stats().damaged, 8);
    let news = log.take_news();
    assert!(news.len() == 1 && news[0].contains("8 times"), "{news:?}");
    assert_eq!(cache.ledger.as_ref().unwrap().total().unwrap(), 0);
}

#[test]
fn a_cache_that_cannot_be_written_is_none() {
    let folder = Folder::new();
    let file = folder.0.join("file");
    fs::write(&file, "in the way").unwrap();
    let log = Arc::new(ErrorLog::default());
    let cache = DiskCache::open(&file, NAME, 1 << 20, Arc::clone(&log));
    cache.put(&key(1), &content(1));
    assert_eq!(cache.get(&key(1)), None);
    let news = log.take_news();
    assert!(news.len() == 1 && news[0].contains("does not work"), "{news:?}");
}

#[test]
fn a_ledger_that_was_lost_is_found_again() {
    let folder = Folder::new();
    let most = 20 * disk_bytes(10_000);
    let cache = folder.open(most);
    (0..20).for_each(|number| cache.put(&key(number), &content(number)));
    // Too high, as if processes had died after they reserved room.
    cache.ledger.as_ref().unwrap().settle(most - 10).unwrap();
    cache.put(&key(50), &content(50));
    assert!(cache.get(&key(50)).is_some() && folder.bytes() <= most);
    assert_eq!(cache.ledger.as_ref().unwrap().total().unwrap(), folder.bytes());
}

#[test]
fn a_cache_is_private_and_one_that_others_may_write_into_is_done_without() {
    use std::os::unix::fs::PermissionsExt;
    let folder = Folder::new();
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
    fs::set_permissions(&folder.0, fs::Permissions::from_mode(0o775)).unwrap();
    let cache = folder.open(1 << 20);
    cache.put(&key(1), &content(1));
    assert!(cache.get(&key(1)).is_some());
    let path = cache.path(&key(1));
    assert!(
        path.ancestors()
            .skip(1)
            .take_while(|path| *path != folder.0.parent().unwrap())
            .all(|path| mode(path) & 0o022 == 0)
    );
    assert_eq!([mode(&folder.0), mode(&folder.0.join("tiles"))], [0o700; 2]);

    // The folder contains the user's own files, so its mode must not be changed.
    fs::write(folder.0.join("notes.txt"), "mine").unwrap();
    fs::set_permissions(&folder.0, fs::Permissions::from_mode(0o777)).unwrap();
    let log = Arc::new(ErrorLog::default());
    let cache = DiskCache::open(&folder.0, NAME, 1 << 20, Arc::clone(&log));
    cache.put(&key(2), &content(2));
    assert!(cache.get(&key(2)).is_none() && cache.get(&key(1)).is_none());
    assert_eq!(mode(&folder.0), 0o777);
    let news = log.take_news();
    assert!(news.len() == 1 && news[0].contains("others may write") && news[0].contains("chmod 700"), "{news:?}");
}

#[test]
fn a_sweep_removes_entries_and_nothing_else() {
    let folder = Folder::new();
    let most = 20 * disk_bytes(10_000);
    let cache = folder.open(most);
    let elsewhere = Folder::new();
    fs::write(elsewhere.0.join("color-1-10000"), "another user's").unwrap();
    let shard = cache.path(&key(0)).parent().unwrap().to_owned();
    fs::create_dir_all(&shard).unwrap();
    let mine = [
        folder.0.join("tiles/photo.jpg"),
        folder.0.join("tiles/holiday/0/color-1-2"),
        shard.join("notes.txt"),
        folder.0.join("index").join(NAME).join("notes.txt"),
    ];
    for path in &mine {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, "mine").unwrap();
    }
    // A link to another folder in place of an entry's folder, and a link in place of an entry.
    std::os::unix::fs::symlink(&elsewhere.0, folder.0.join("tiles").join(NAME).join("ff")).unwrap();
    std::os::unix::fs::symlink(elsewhere.0.join("color-1-10000"), shard.join("color-7-10000")).unwrap();
    let old = SystemTime::now() - Duration::from_secs(1_000_000);
    for path in mine.iter().chain([&elsewhere.0.join("color-1-10000")]) {
        File::options().write(true).open(path).unwrap().set_times(FileTimes::new().set_modified(old)).unwrap();
    }
    (0..60).for_each(|number| cache.put(&key(number), &content(number)));
    assert!(folder.bytes() > 0 && cache.get(&key(59)).is_some() && cache.get(&key(0)).is_none(), "room was made");
    assert!(mine.iter().chain([&elsewhere.0.join("color-1-10000")]).all(|path| path.exists()));
    assert!(shard.join("color-7-10000").symlink_metadata().is_ok());
}
