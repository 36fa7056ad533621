//! Where a database is: a folder, a web server or a bucket.

use std::ffi::OsStr;
use std::fmt;
use std::path::{Path, PathBuf};
use terravision_common::database::MANIFEST_FILE;
use url::Url;

/// Why a text is not a location.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LocationError {
    /// A URL with a scheme that is not supported.
    #[error(
        "the scheme of a database is {found}://, expected a folder, http://, https:// or s3://bucket/prefix: {text}"
    )]
    Scheme {
        /// The scheme.
        found: String,
        /// The location.
        text: String,
    },
    /// It is not a URL.
    #[error("the database's URL cannot be read: {reason}: {text}")]
    Url {
        /// What is wrong with it.
        reason: String,
        /// The location.
        text: String,
    },
}

/// Where a terrain database is. `Display` leaves out what may be secret: user, password and query
/// of a URL.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Location(Kind);

#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Kind {
    /// On this machine.
    Folder(PathBuf),
    /// An archive on this machine.
    Archive(PathBuf),
    /// On a web server that honours byte ranges.
    Http(Url),
    /// In a bucket of an S3 server.
    S3 {
        /// The bucket.
        bucket: String,
        /// The folder in the bucket, without slashes at its ends; may be empty.
        prefix: String,
    },
}

impl Location {
    /// Parses a location: `world.tv`, `file:///data/world.tv`, `http://host/world.tv`, `https://…`,
    /// `s3://bucket/prefix`. The path of a manifest stands for its folder. A name that ends in
    /// `.tar` is an archive that contains the files of a database.
    ///
    /// # Errors
    /// [`LocationError`].
    pub fn parse(text: &str) -> Result<Self, LocationError> {
        let Some((scheme, rest)) = text.split_once("://").filter(|(scheme, _)| is_scheme(scheme)) else {
            return Ok(Self::path(Path::new(text)));
        };
        let bad =
            |reason: &dyn fmt::Display| LocationError::Url { reason: reason.to_string(), text: without_secrets(text) };
        let kind = match scheme.to_ascii_lowercase().as_str() {
            "file" => match Url::parse(text).map_err(|e| bad(&e))?.to_file_path() {
                Ok(path) => return Ok(Self::path(&path)),
                Err(()) => return Err(bad(&"it names no file of this machine")),
            },
            "http" | "https" => Kind::Http(http_folder(text).map_err(|e| bad(&e))?),
            "s3" => {
                let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
                if bucket.is_empty() || bucket.contains(['?', '#', '@']) {
                    return Err(bad(&"it names no bucket"));
                }
                let prefix = prefix.trim_matches('/');
                let prefix = prefix.strip_suffix(MANIFEST_FILE).unwrap_or(prefix).trim_end_matches('/');
                Kind::S3 { bucket: bucket.to_owned(), prefix: prefix.to_owned() }
            }
            _ => return Err(LocationError::Scheme { found: scheme.to_owned(), text: without_secrets(text) }),
        };
        Ok(Self(kind))
    }

    /// Parses a location of a command line, where names of folders need not be Unicode.
    ///
    /// # Errors
    /// [`LocationError`].
    pub fn parse_os(text: &OsStr) -> Result<Self, LocationError> {
        match text.to_str() {
            Some(text) => Self::parse(text),
            None => Ok(Self::path(Path::new(text))),
        }
    }

    /// A local folder, or an archive when its name says so and it is not a folder.
    fn path(path: &Path) -> Self {
        let has_name = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("tar"));
        if has_name && !path.is_dir() { Self(Kind::Archive(path.to_owned())) } else { Self::folder(path) }
    }

    /// A local folder.
    #[must_use]
    pub fn folder(path: &Path) -> Self {
        Self(Kind::Folder(path.to_owned()))
    }

    pub(crate) fn kind(&self) -> &Kind {
        &self.0
    }

    /// The folder, if it is local.
    #[must_use]
    pub fn as_folder(&self) -> Option<&Path> {
        match &self.0 {
            Kind::Folder(path) => Some(path),
            _ => None,
        }
    }

    /// The folder or the archive, if it is local.
    #[must_use]
    pub fn as_path(&self) -> Option<&Path> {
        match &self.0 {
            Kind::Folder(path) | Kind::Archive(path) => Some(path),
            _ => None,
        }
    }

    /// Whether it is an archive, local or remote.
    #[must_use]
    pub fn is_archive(&self) -> bool {
        let is_tar = |name: &str| {
            name.len() > 4 && name.get(name.len() - 4..).is_some_and(|end| end.eq_ignore_ascii_case(".tar"))
        };
        match &self.0 {
            Kind::Folder(_) => false,
            Kind::Archive(_) => true,
            Kind::Http(url) => is_tar(url.path()),
            Kind::S3 { prefix, .. } => is_tar(prefix),
        }
    }

    /// The location in the form that [`Location::parse`] reads, including secrets: for other
    /// processes only, never for display.
    #[must_use]
    pub fn to_argument(&self) -> String {
        match &self.0 {
            Kind::Folder(path) | Kind::Archive(path) => path.display().to_string(),
            Kind::Http(url) => url.to_string(),
            Kind::S3 { bucket, prefix } => format!("s3://{bucket}/{prefix}"),
        }
    }
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.0 {
            Kind::Folder(path) | Kind::Archive(path) => write!(f, "{}", path.display()),
            Kind::Http(url) => f.write_str(&without_secrets(url.as_str())),
            Kind::S3 { bucket, prefix } => write!(f, "s3://{bucket}/{prefix}"),
        }
    }
}

/// The scheme of a URL (RFC 3986, section 3.1).
fn is_scheme(text: &str) -> bool {
    let is_part = |c: char| c.is_ascii_alphanumeric() || "+-.".contains(c);
    text.starts_with(|c: char| c.is_ascii_alphabetic()) && text.chars().all(is_part)
}

/// The URL of a folder: without a slash at its end, without fragment; its query goes with every
/// request.
fn http_folder(text: &str) -> Result<Url, url::ParseError> {
    let mut url = Url::parse(text)?;
    url.set_fragment(None);
    let path = url.path();
    let path = path.strip_suffix(MANIFEST_FILE).filter(|path| path.ends_with('/')).unwrap_or(path);
    let path = path.trim_end_matches('/').to_owned();
    url.set_path(&path);
    Ok(url)
}

/// A URL for display: its user, password and query may be secret.
fn without_secrets(text: &str) -> String {
    match Url::parse(text) {
        Ok(mut url) => {
            // A URL without a host has no user either.
            url.set_username("").unwrap_or_default();
            url.set_password(None).unwrap_or_default();
            url.set_query(None);
            url.to_string()
        }
        Err(_) => text.split(['?', '@']).next().unwrap_or_default().to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parsed(text: &str) -> String {
        Location::parse(text).expect("a location").to_argument()
    }

    #[test]
    fn folders_urls_and_buckets_are_told_apart() {
        assert_eq!(Location::parse("a/w.tv").expect("a folder").as_folder(), Some(Path::new("a/w.tv")));
        assert_eq!(Location::parse("C:/a://b").expect("a folder").as_folder(), Some(Path::new("C:/a://b")));
        assert_eq!(Location::parse("file:///a/w%20x.tv").expect("a folder").as_folder(), Some(Path::new("/a/w x.tv")));
        assert_eq!(parsed("http://h:8080/a/w.tv/"), "http://h:8080/a/w.tv");
        assert_eq!(parsed("HTTPS://h/a/w.tv/manifest.json#x"), "https://h/a/w.tv");
        assert_eq!(parsed("https://h/w.tv?token=1"), "https://h/w.tv?token=1");
        assert_eq!(parsed("s3://b/a/w.tv/"), "s3://b/a/w.tv");
        assert_eq!(parsed("s3://b"), "s3://b/");
        assert_eq!(Location::parse("a/w.tar").expect("an archive").as_path(), Some(Path::new("a/w.tar")));
        let is_archive = |text: &str| Location::parse(text).expect("a location").is_archive();
        assert!(
            ["w.tar", "file:///a/w.TAR", "http://h/w.tar?key=1", "s3://b/a/w.tar"].iter().all(|text| is_archive(text))
        );
        assert!(!["w.tv", "http://h/tar", "http://h/w.tar.tv", "s3://tar"].iter().any(|text| is_archive(text)));
    }

    #[test]
    fn what_cannot_be_read_is_refused_in_a_sentence() {
        let refused = |text: &str| Location::parse(text).expect_err("no location").to_string();
        assert!(refused("ftp://h/w.tv").contains("ftp://, expected a folder, http://"));
        assert!(refused("http://").contains("cannot be read"));
        assert!(refused("http://h:99999/x").contains("port"));
        assert!(refused("s3:///x").contains("no bucket"));
    }

    #[test]
    fn secrets_are_not_shown() {
        let location = Location::parse("https://me:word@h/w.tv?key=word").expect("a location");
        assert_eq!(location.to_string(), "https://h/w.tv");
        assert_eq!(parsed(&location.to_argument()), "https://me:word@h/w.tv?key=word");
        let refused = Location::parse("ftp://me:word@h/w.tv?key=word").expect_err("no location").to_string();
        assert!(!refused.contains("word"), "{refused}");
    }

    proptest! {
        #[test]
        fn any_text_is_a_location_or_an_error(text: String) {
            if let Ok(location) = Location::parse(&text)
                && location.as_path().is_none()
            {
                let again = Location::parse(&location.to_argument()).expect("what it gave itself");
                prop_assert_eq!(again, location);
            }
        }
    }
}
