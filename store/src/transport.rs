//! A single request to a server, through `object_store`: an answer, or a classified failure.
//! Nothing is repeated here.

use crate::error::{Cause, Fault, StoreError};
use crate::location::{Kind, Location};
use crate::options::StoreOptions;
use crate::redirect::ConnectOptions;
use crate::tar::{BLOCK, Headers, Next};
use crate::wire::{Connector, Wire};
use crate::wire_error::WireError;
use bytes::{Bytes, BytesMut};
use futures_util::TryStreamExt;
use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::client::HttpError;
use object_store::http::HttpBuilder;
use object_store::path::Path as ObjectPath;
use object_store::{ClientOptions, GetOptions, GetRange, ObjectStore, RetryConfig};
use std::collections::BTreeMap;
use std::error::Error;
use std::io;
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, UNIX_EPOCH};
use terravision_common::files::open_regular;
use tokio::sync::OnceCell;

/// Timeout of a connection attempt.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// The answer to a request.
#[derive(Debug)]
pub(crate) struct Answer {
    /// Exactly the requested bytes.
    pub(crate) bytes: Bytes,
    /// Length of the whole file.
    pub(crate) file_bytes: u64,
    /// The ETag of this content, if the server sends one.
    pub(crate) etag: Option<String>,
    /// When the request was made, if it was repeated because the one before took much longer than
    /// usual.
    pub(crate) resent_at: Option<std::time::Instant>,
}

/// How bytes are read.
#[derive(Debug)]
enum Access {
    Server(Box<dyn ObjectStore>),
    /// A local archive.
    File(PathBuf),
}

/// A client for the server of a database.
#[derive(Debug)]
pub(crate) struct Transport {
    access: Access,
    prefix: String,
    /// For an archive: its object, and where its members lie.
    archive: Option<ObjectPath>,
    members: OnceCell<BTreeMap<String, Range<u64>>>,
    location: Location,
    wire: Arc<Wire>,
}

impl Transport {
    /// A client for a location; `None` for a local folder.
    pub(crate) fn new(location: &Location, options: &StoreOptions) -> Result<Option<Self>, StoreError> {
        if location.as_folder().is_some() {
            return Ok(None);
        }
        let wire = Arc::new(Wire::default());
        let connect = ConnectOptions {
            connect_timeout: CONNECT_TIMEOUT.min(options.request_timeout),
            idle_connections: options.parallel_requests.max(1),
        };
        // Retries and timeouts are handled in `network`.
        let retries = RetryConfig { max_retries: 0, retry_timeout: Duration::ZERO, ..RetryConfig::default() };
        let client = ClientOptions::new()
            .with_allow_http(true)
            .with_connect_timeout(connect.connect_timeout)
            .with_timeout_disabled()
            .with_pool_max_idle_per_host(connect.idle_connections);
        let connector = Connector::new(Arc::clone(&wire), connect);
        let failed = |error: object_store::Error| StoreError::Client {
            why: deepest(&error).to_string(),
            location: location.to_string(),
        };
        install_crypto();
        let is_archive = location.is_archive();
        let no_path = |error: object_store::path::Error| StoreError::Client {
            why: error.to_string(),
            location: location.to_string(),
        };
        let mut archive = None;
        let (access, prefix) = match location.kind() {
            Kind::Folder(_) => return Ok(None),
            Kind::Archive(path) => (Access::File(path.clone()), String::new()),
            Kind::Http(url) => {
                let mut url = url.clone();
                if let Some((folder, file)) = url.path().rsplit_once('/').filter(|_| is_archive) {
                    archive = Some(ObjectPath::from_url_path(file).map_err(no_path)?);
                    let folder = folder.to_owned();
                    url.set_path(&folder);
                }
                let builder = HttpBuilder::new().with_url(url.as_str()).with_client_options(client);
                let store = builder.with_retry(retries).with_http_connector(connector).build().map_err(failed)?;
                (Access::Server(Box::new(store)), String::new())
            }
            Kind::S3 { bucket, prefix } => {
                let builder = s3_from_environment().with_bucket_name(bucket).with_client_options(client);
                let store = builder.with_retry(retries).with_http_connector(connector).build().map_err(failed)?;
                if is_archive {
                    archive = Some(ObjectPath::parse(prefix).map_err(no_path)?);
                }
                (Access::Server(Box::new(store)), prefix.clone())
            }
        };
        Ok(Some(Self { access, prefix, archive, members: OnceCell::new(), location: location.clone(), wire }))
    }

    /// Statistics of the connection, and the server's `Retry-After`.
    pub(crate) fn wire(&self) -> &Wire {
        &self.wire
    }

    /// Whether it is local: then damage is permanent.
    pub(crate) fn is_local(&self) -> bool {
        matches!(self.access, Access::File(_))
    }

    /// Name of a file of the database, for messages.
    pub(crate) fn place(&self, file: &str) -> String {
        match self.location.kind() {
            Kind::S3 { .. } if self.prefix.is_empty() => format!("{}{file}", self.location),
            _ => format!("{}/{file}", self.location),
        }
    }

    /// Requests a range of a file, or the whole file if that has at most `most_bytes` bytes.
    pub(crate) async fn get(&self, file: &str, range: Option<Range<u64>>, most_bytes: u64) -> Result<Answer, Fault> {
        if !self.location.is_archive() {
            let name = if self.prefix.is_empty() { file.to_owned() } else { format!("{}/{file}", self.prefix) };
            let fault = |error: object_store::path::Error| self.fault(file, Cause::Refused, error.to_string());
            return self.get_object(file, &ObjectPath::parse(name).map_err(fault)?, range, most_bytes).await;
        }
        let members = self.members.get_or_try_init(|| self.read_members()).await?;
        let missing = || self.fault(file, Cause::NotFound, "the archive has no such file".to_owned());
        let member = members.get(file).ok_or_else(missing)?;
        let file_bytes = member.end - member.start;
        let range = range.unwrap_or(0..file_bytes);
        if range.start > range.end || range.end > file_bytes || range.end - range.start > most_bytes {
            let why = format!("it has {file_bytes} bytes, and {} to {} were expected", range.start, range.end);
            return Err(self.fault(file, Cause::BadAnswer, why));
        }
        // Within the member, so that the sum cannot overflow.
        let answer = self.get_archive(file, member.start + range.start..member.start + range.end).await?;
        Ok(Answer { file_bytes, ..answer })
    }

    /// Finds out where the members of an archive lie.
    async fn read_members(&self) -> Result<BTreeMap<String, Range<u64>>, Fault> {
        let mut headers = Headers::default();
        loop {
            let range = match headers.next() {
                Next::Header(at) => *at..at.saturating_add(BLOCK),
                Next::Extended(range) => range.clone(),
                Next::End => return Ok(headers.members),
            };
            let answer = self.get_archive("", range).await?;
            let taken = headers.take(&answer.bytes);
            taken.map_err(|error| self.fault("", Cause::NotFound, error.to_string()))?;
            // Next comes another header, or the archive ends without its final blocks.
            let is_over = matches!(headers.next(), Next::Header(at) if *at >= answer.file_bytes);
            if is_over {
                return Ok(headers.members);
            }
        }
    }

    /// Requests a range of the archive.
    async fn get_archive(&self, file: &str, range: Range<u64>) -> Result<Answer, Fault> {
        let bytes = range.end - range.start;
        match (&self.access, &self.archive) {
            (Access::Server(_), Some(archive)) => self.get_object(file, archive, Some(range), bytes).await,
            (Access::File(path), _) => {
                self.wire.count_request();
                let from = path.clone();
                let read = tokio::task::spawn_blocking(move || read_file(&from, range)).await;
                let read = read.unwrap_or_else(|_| Err(io::Error::other("the read was given up")));
                read.map_err(|error| {
                    let cause = match error.kind() {
                        io::ErrorKind::NotFound => Cause::NotFound,
                        io::ErrorKind::PermissionDenied => Cause::Denied,
                        _ => Cause::Disk,
                    };
                    self.fault(file, cause, error.to_string())
                })
            }
            (Access::Server(_), None) => Err(self.fault(file, Cause::NotFound, "it is not an archive".to_owned())),
        }
    }

    fn fault(&self, file: &str, cause: Cause, why: String) -> Fault {
        let place = if file.is_empty() { self.location.to_string() } else { self.place(file) };
        Fault { cause, why, place }
    }

    async fn get_object(
        &self,
        file: &str,
        path: &ObjectPath,
        range: Option<Range<u64>>,
        most_bytes: u64,
    ) -> Result<Answer, Fault> {
        let fault = |cause, why: String| self.fault(file, cause, why);
        let Access::Server(store) = &self.access else {
            return Err(fault(Cause::Disk, "it is not a server".to_owned()));
        };
        let options = GetOptions { range: range.clone().map(GetRange::Bounded), ..GetOptions::default() };
        let told = |error: object_store::Error| {
            let (cause, why) = classify(&error);
            fault(cause, why)
        };
        let result = store.get_opts(path, options).await.map_err(told)?;
        let expected = range.as_ref().map_or(result.meta.size, |range| range.end - range.start);
        if expected > most_bytes {
            return Err(fault(Cause::BadAnswer, format!("it has {expected} bytes, expected at most {most_bytes}")));
        }
        let (file_bytes, etag) = (result.meta.size, result.meta.e_tag.clone());
        let mut bytes = BytesMut::with_capacity(expected as usize);
        let mut stream = result.into_stream();
        while let Some(part) = stream.try_next().await.map_err(told)? {
            self.wire.count_bytes(part.len());
            if bytes.len() + part.len() > expected as usize {
                return Err(fault(
                    Cause::BadAnswer,
                    format!("more than the {expected} bytes came that were asked for"),
                ));
            }
            bytes.extend_from_slice(&part);
        }
        if (bytes.len() as u64) < expected {
            let why = format!("the answer ended after {} of {expected} bytes", bytes.len());
            return Err(fault(Cause::Interrupted, why));
        }
        Ok(Answer { bytes: bytes.freeze(), file_bytes, etag, resent_at: None })
    }
}

/// Reads a range of a file; blocks.
fn read_file(path: &std::path::Path, range: Range<u64>) -> io::Result<Answer> {
    let file = open_regular(path)?;
    let about = file.metadata()?;
    if range.end > about.len() {
        let why = format!("the archive ends after {} bytes and its content goes on: it was cut short", about.len());
        return Err(io::Error::new(io::ErrorKind::UnexpectedEof, why));
    }
    // At most a piece or a tile: callers bound the range.
    let mut bytes = vec![0; (range.end - range.start) as usize];
    file.read_exact_at(&mut bytes, range.start)?;
    let modified = about.modified()?.duration_since(UNIX_EPOCH).unwrap_or_default();
    Ok(Answer { bytes: bytes.into(), file_bytes: about.len(), etag: Some(format!("{modified:?}")), resent_at: None })
}

/// Configures S3 from the usual variables: AWS_ACCESS_KEY_ID, AWS_REGION, AWS_ENDPOINT_URL… An
/// empty variable counts as not set.
fn s3_from_environment() -> AmazonS3Builder {
    let variables =
        std::env::vars_os().filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)));
    let variables = variables.filter(|(name, value)| name.starts_with("AWS_") && !value.is_empty());
    variables.fold(AmazonS3Builder::new(), |builder, (name, value)| {
        match name.to_ascii_lowercase().parse::<AmazonS3ConfigKey>() {
            Ok(key) => builder.with_config(key, value),
            Err(_another_program_s) => builder,
        }
    })
}

/// Installs the process-wide provider of cryptography for TLS; another crate may have done so
/// already.
fn install_crypto() {
    drop(rustls::crypto::ring::default_provider().install_default());
}

fn chain<'e>(error: &'e (dyn Error + 'static)) -> impl Iterator<Item = &'e (dyn Error + 'static)> {
    std::iter::successors(Some(error), |error| {
        // An I/O error that wraps another error returns that error's source as its own, and so
        // hides it.
        let made_of = error.downcast_ref::<io::Error>().and_then(io::Error::get_ref);
        made_of.map(|inner| inner as &(dyn Error + 'static)).or_else(|| <dyn Error>::source(*error))
    })
}

fn deepest<'e>(error: &'e (dyn Error + 'static)) -> &'e (dyn Error + 'static) {
    chain(error).last().unwrap_or(error)
}

/// Why a server's certificate is not trusted, and what the user can do.
fn certificate_sentence(reason: &rustls::CertificateError) -> String {
    use rustls::CertificateError as Reason;
    let why = match reason {
        Reason::Expired | Reason::ExpiredContext { .. } => "has expired".to_owned(),
        Reason::NotValidYet | Reason::NotValidYetContext { .. } => "is not valid yet (is the clock right?)".to_owned(),
        Reason::NotValidForName | Reason::NotValidForNameContext { .. } => {
            "is for another host name than that of the address".to_owned()
        }
        Reason::UnknownIssuer => "is not trusted: no authority that this machine trusts has signed it; SSL_CERT_FILE names a \
             file of certificates that are trusted"
            .to_owned(),
        Reason::BadSignature => "is not trusted: it was not signed by the issuer that it names".to_owned(),
        Reason::Revoked => "was revoked".to_owned(),
        // It can only be recognized by its text: rustls has no variant for it.
        other if format!("{other:?}").contains("CaUsedAsEndEntity") => {
            "is not trusted: it is that of an authority (CA:TRUE), and a server needs one of its own; openssl req -x509 makes it \
             with -addext basicConstraints=critical,CA:FALSE, and SSL_CERT_FILE names it"
                .to_owned()
        }
        other => format!("is not trusted ({other})"),
    };
    format!("the server's certificate {why}")
}

/// The kind of a client error, and a clause that describes it.
fn classify(error: &object_store::Error) -> (Cause, String) {
    if let Some(wire) = chain(error).find_map(|e| e.downcast_ref::<WireError>()) {
        return (wire.cause, wire.to_string());
    }
    let why = deepest(error).to_string();
    if matches!(error, object_store::Error::NotSupported { .. }) {
        return (Cause::NoRanges, "the server does not honour byte ranges".to_owned());
    }
    match chain(error).find_map(|e| e.downcast_ref::<rustls::Error>()) {
        Some(rustls::Error::InvalidCertificate(reason)) => {
            return (Cause::Certificate, certificate_sentence(reason));
        }
        Some(tls) => return (Cause::Certificate, format!("TLS with the server failed ({tls})")),
        None => {}
    }
    let client = chain(error).find_map(|e| e.downcast_ref::<reqwest::Error>());
    let is_name = chain(error).any(|e| e.to_string().starts_with("dns error"));
    if is_name {
        return (Cause::Name, format!("the name of the server does not resolve ({why})"));
    }
    if let Some(client) = client {
        if client.is_redirect() {
            return (Cause::Redirects, "the server redirects without end".to_owned());
        }
        if client.is_timeout() {
            return (Cause::Timeout, "no answer in time".to_owned());
        }
        if client.is_connect() {
            return (Cause::Connect, format!("no connection ({why})"));
        }
        return (Cause::Interrupted, format!("the connection broke ({why})"));
    }
    if chain(error).any(|e| e.downcast_ref::<HttpError>().is_some()) {
        return (Cause::Interrupted, format!("the connection broke ({why})"));
    }
    (Cause::BadAnswer, format!("the answer is not valid ({why})"))
}
