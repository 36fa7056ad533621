//! Where the page is served: the address, the token that it needs, and who may show it.

use crate::cli::serve::ServeArgs;
use crate::failure::Failure;
use anyhow::anyhow;
use std::io::ErrorKind;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, UdpSocket};

/// Lengths of a token.
const TOKEN_BYTES: [usize; 2] = [8, 256];

/// Listens where it is asked to.
pub(super) fn listen(args: &ServeArgs) -> Result<TcpListener, Failure> {
    let ServeArgs { addr, token, allow_embed, .. } = args;
    if !addr.ip().is_loopback() && token.is_none() {
        return Err(Failure::bad_input(anyhow!(
            "--addr {addr}: everybody who can reach this machine could look around and move the camera; add --token \
             TOKEN (at least {} characters), or listen at 127.0.0.1",
            TOKEN_BYTES[0]
        )));
    }
    token.as_deref().map_or(Ok(()), check_token)?;
    allow_embed.iter().try_for_each(|origin| check_origin(origin))?;
    TcpListener::bind(addr).map_err(|error| {
        let advice = match error.kind() {
            ErrorKind::AddrInUse => {
                format!("; take another port, or --addr {} for a free one", SocketAddr::new(addr.ip(), 0))
            }
            _ => String::new(),
        };
        Failure::bad_input(anyhow!("--addr {addr}: cannot listen there: {error}{advice}"))
    })
}

fn check_token(token: &str) -> Result<(), Failure> {
    let is_plain = token.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-_".contains(&byte));
    let [least, most] = TOKEN_BYTES;
    if is_plain && (least..=most).contains(&token.len()) {
        return Ok(());
    }
    Err(Failure::bad_input(anyhow!("--token: expected {least} to {most} letters, digits, - and _")))
}

/// A scheme, a host, and maybe a port.
fn check_origin(origin: &str) -> Result<(), Failure> {
    let host = origin.strip_prefix("https://").or_else(|| origin.strip_prefix("http://"));
    let is_host = |host: &str| {
        !host.is_empty() && host.bytes().all(|byte| byte.is_ascii_alphanumeric() || b".-:[]".contains(&byte))
    };
    if host.is_some_and(is_host) {
        return Ok(());
    }
    Err(Failure::bad_input(anyhow!(
        "--allow-embed {origin:?}: expected an origin without a path, e.g. https://example.org or http://localhost:3000"
    )))
}

/// The address to open.
pub(super) fn page_address(listening: SocketAddr, token: Option<&str>) -> String {
    let ip = if listening.ip().is_unspecified() { own_address() } else { listening.ip() };
    let query = token.map(|token| format!("?token={token}")).unwrap_or_default();
    format!("http://{}/{query}", SocketAddr::new(ip, listening.port()))
}

/// The address by which others reach this machine, as far as it knows.
fn own_address() -> IpAddr {
    // Nothing is sent: the system chooses the address that it would send from. The other end is one
    // that documents use (RFC 5737).
    let chosen = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).and_then(|socket| {
        socket.connect((Ipv4Addr::new(192, 0, 2, 1), 9))?;
        socket.local_addr()
    });
    chosen.map_or(IpAddr::V4(Ipv4Addr::LOCALHOST), |address| address.ip())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_and_origins_are_checked() {
        assert!(check_token("3fK9qUw2-_bYc81").is_ok());
        for bad in ["", "short", "with a blank", "ümlaut-ümlaut", &"x".repeat(257)] {
            assert!(check_token(bad).is_err(), "{bad}");
        }
        for good in ["https://example.org", "http://localhost:3000", "http://[::1]:80"] {
            assert!(check_origin(good).is_ok(), "{good}");
        }
        for bad in ["example.org", "https://", "https://a/b", "https://a b", "https://a;script-src", "*"] {
            assert!(check_origin(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn the_address_has_the_token() {
        let address = page_address("127.0.0.1:80".parse().unwrap(), Some("abcdefgh"));
        assert_eq!(address, "http://127.0.0.1:80/?token=abcdefgh");
        assert!(!page_address("0.0.0.0:80".parse().unwrap(), None).contains("0.0.0.0"));
    }
}
