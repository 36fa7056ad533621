//! One request to a server, by `object_store`: what came, or what kind of failure it was. Nothing is asked twice here.

use crate::error::{Cause, Fault, StoreError};
use crate::location::{Kind, Location};
use crate::options::StoreOptions;
use crate::wire::{Connector, Wire, WireError};
use bytes::{Bytes, BytesMut};
use futures_util::TryStreamExt;
use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::client::HttpError;
use object_store::http::HttpBuilder;
use object_store::path::Path as ObjectPath;
use object_store::{ClientOptions, GetOptions, GetRange, ObjectStore, RetryConfig};
use std::error::Error;
use std::io;
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

/// Longest time to make a connection.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// What a request brought.
#[derive(Debug)]
pub(crate) struct Answer {
    /// The bytes asked for, no more and no fewer.
    pub(crate) bytes: Bytes,
    /// Length of the whole file.
    pub(crate) file_bytes: u64,
    /// The server's mark of this content, if it gives one.
    pub(crate) etag: Option<String>,
}

/// A client of the server that has a database.
#[derive(Debug)]
pub(crate) struct Transport {
    store: Box<dyn ObjectStore>,
    prefix: String,
    location: Location,
    wire: Arc<Wire>,
}

impl Transport {
    /// A client for a location that is not a folder; `None` for one that is.
    pub(crate) fn new(location: &Location, options: &StoreOptions) -> Result<Option<Self>, StoreError> {
        if location.as_folder().is_some() {
            return Ok(None);
        }
        let wire = Arc::new(Wire::default());
        let connector = Connector::new(Arc::clone(&wire));
        // Retries, and the time that each request may take, are ours: see `network`.
        let retries = RetryConfig { max_retries: 0, retry_timeout: Duration::ZERO, ..RetryConfig::default() };
        let client = ClientOptions::new()
            .with_allow_http(true)
            .with_connect_timeout(CONNECT_TIMEOUT.min(options.request_timeout))
            .with_timeout_disabled()
            .with_pool_max_idle_per_host(options.parallel_requests.max(1));
        let failed = |error: object_store::Error| StoreError::Client {
            why: deepest(&error).to_string(),
            location: location.to_string(),
        };
        install_crypto();
        let (store, prefix): (Box<dyn ObjectStore>, _) = match location.kind() {
            Kind::Folder(_) => return Ok(None),
            Kind::Http(url) => {
                let builder = HttpBuilder::new().with_url(url.as_str()).with_client_options(client);
                let store = builder.with_retry(retries).with_http_connector(connector).build().map_err(failed)?;
                (Box::new(store), String::new())
            }
            Kind::S3 { bucket, prefix } => {
                let builder = s3_from_environment().with_bucket_name(bucket).with_client_options(client);
                let store = builder.with_retry(retries).with_http_connector(connector).build().map_err(failed)?;
                (Box::new(store), prefix.clone())
            }
        };
        Ok(Some(Self { store, prefix, location: location.clone(), wire }))
    }

    /// What passed over the wire so far, and when the server wants to be asked again.
    pub(crate) fn wire(&self) -> &Wire {
        &self.wire
    }

    /// Name of a file of the database, for messages.
    pub(crate) fn place(&self, file: &str) -> String {
        match self.location.kind() {
            Kind::S3 { .. } if self.prefix.is_empty() => format!("{}{file}", self.location),
            _ => format!("{}/{file}", self.location),
        }
    }

    /// Asks for a range of a file, or for all of a file of at most `most_bytes` bytes.
    pub(crate) async fn get(&self, file: &str, range: Option<Range<u64>>, most_bytes: u64) -> Result<Answer, Fault> {
        let fault = |cause, why: String| Fault { cause, why, place: self.place(file) };
        let name = if self.prefix.is_empty() { file.to_owned() } else { format!("{}/{file}", self.prefix) };
        let options = GetOptions { range: range.clone().map(GetRange::Bounded), ..GetOptions::default() };
        let told = |error: object_store::Error| {
            let (cause, why) = classify(&error);
            fault(cause, why)
        };
        let path = ObjectPath::parse(name).map_err(|error| fault(Cause::Refused, error.to_string()))?;
        let result = self.store.get_opts(&path, options).await.map_err(told)?;
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
        Ok(Answer { bytes: bytes.freeze(), file_bytes, etag })
    }
}

/// S3 as the usual variables say: AWS_ACCESS_KEY_ID, AWS_REGION, AWS_ENDPOINT_URL… One that is empty is not set.
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

/// TLS needs a provider of cryptography for the whole process; another crate may have chosen one already.
fn install_crypto() {
    drop(rustls::crypto::ring::default_provider().install_default());
}

fn chain<'e>(error: &'e (dyn Error + 'static)) -> impl Iterator<Item = &'e (dyn Error + 'static)> {
    std::iter::successors(Some(error), |error| {
        // An i/o error that was made of another one gives that one's source as its own, and so hides it.
        let made_of = error.downcast_ref::<io::Error>().and_then(io::Error::get_ref);
        made_of.map(|inner| inner as &(dyn Error + 'static)).or_else(|| <dyn Error>::source(*error))
    })
}

fn deepest<'e>(error: &'e (dyn Error + 'static)) -> &'e (dyn Error + 'static) {
    chain(error).last().unwrap_or(error)
}

/// What kind of failure an error of the client is, and a clause about it.
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
            return (Cause::Certificate, format!("the server's certificate is not trusted ({reason})"));
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
    (Cause::BadAnswer, format!("the answer makes no sense ({why})"))
}
