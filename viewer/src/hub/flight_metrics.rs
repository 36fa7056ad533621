//! The flight's own metrics: asked for at its address on this machine.

use super::Hub;
use serde_json::{Map, Value};
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

/// Longest answer of the flight, bytes.
const MOST_METRICS_BYTES: u64 = 256 << 10;
/// Longest time for it.
const WITHIN: Duration = Duration::from_secs(2);
/// Between two questions, while somebody looks.
const EVERY: Duration = Duration::from_secs(1);

/// The metrics of a flight that serves them at this address, as Prometheus text.
pub(crate) async fn metrics_at(address: SocketAddr) -> Option<String> {
    answer_at(address, "/metrics").await
}

/// What a flight answers at this address.
pub(super) async fn answer_at(address: SocketAddr, path: &str) -> Option<String> {
    let ask = async {
        let mut stream = TcpStream::connect(address).await?;
        let request = format!("GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
        stream.write_all(request.as_bytes()).await?;
        let mut answer = String::new();
        stream.take(MOST_METRICS_BYTES).read_to_string(&mut answer).await?;
        Ok::<_, std::io::Error>(answer)
    };
    let answer = tokio::time::timeout(WITHIN, ask).await.ok()?.ok()?;
    let (head, body) = answer.split_once("\r\n\r\n")?;
    head.starts_with("HTTP/1.1 200").then(|| body.to_owned())
}

impl Hub {
    /// The metrics of the flight as Prometheus text; `None` while it has none.
    pub(crate) async fn metrics_of_flight(&self) -> Option<String> {
        let address = self.flight.borrow().metrics?;
        metrics_at(address).await
    }
}

/// The numbers of a Prometheus text by name, without histograms.
fn numbers(text: &str) -> Value {
    let lines = text.lines().filter(|line| !line.starts_with('#') && !line.contains("_bucket{"));
    let pairs = lines.filter_map(|line| line.rsplit_once(' '));
    // Of causes of failures those that occurred.
    let pairs = pairs.filter(|(name, value)| !(name.contains("{cause=") && *value == "0"));
    let numbers = pairs.filter_map(|(name, value)| Some((name.to_owned(), value.parse::<f64>().ok()?.into())));
    Value::Object(numbers.collect::<Map<_, _>>())
}

/// Asks as long as the process lives and somebody looks.
pub(crate) async fn watch(hub: Arc<Hub>) {
    loop {
        let asked = if hub.clients() > 0 { hub.metrics_of_flight().await } else { None };
        hub.flight_metrics.send_replace(asked.map_or(Value::Null, |text| numbers(&text)));
        tokio::time::sleep(EVERY).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_the_names_of_prometheus() {
        let text = "# HELP a b\na 3\nb{stage=\"renderer\"} 0.5\nc_bucket{le=\"1\"} 1\nd{cause=\"x\"} 0\nbroken\n";
        assert_eq!(numbers(text), serde_json::json!({"a": 3.0, "b{stage=\"renderer\"}": 0.5}));
    }
}
