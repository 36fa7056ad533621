//! JSON lines in datagrams.

use super::message::Message;
use std::collections::VecDeque;
use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::time::Duration;

/// Largest datagram that there is.
const DATAGRAM_BYTES: usize = 65536;

/// A port that datagrams come in at.
#[derive(Debug)]
pub(super) struct UdpPort {
    socket: UdpSocket,
    address: SocketAddr,
    buffer: Vec<u8>,
    /// Lines of the last datagram that were not taken yet.
    lines: VecDeque<Message>,
}

impl UdpPort {
    pub(super) fn open(address: SocketAddr) -> io::Result<Self> {
        let socket = UdpSocket::bind(address)?;
        let address = socket.local_addr()?;
        Ok(Self { socket, address, buffer: vec![0; DATAGRAM_BYTES], lines: VecDeque::new() })
    }

    /// Where it listens: with port 0 the system chose one.
    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }

    /// The next line; waits for one, `timeout` at most (a millisecond at least).
    pub(super) fn next(&mut self, timeout: Duration) -> Option<Message> {
        if self.lines.is_empty() {
            self.socket.set_read_timeout(Some(timeout.max(Duration::from_millis(1)))).ok()?;
            // On an error there is no datagram: the wait was interrupted or timed out.
            let count = self.socket.recv(&mut self.buffer).ok()?;
            let lines = self.buffer.get(..count)?.split(|&byte| byte == b'\n');
            let lines = lines.map(<[u8]>::trim_ascii).filter(|line| !line.is_empty());
            self.lines.extend(lines.map(Message::of_json));
        }
        self.lines.pop_front()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_come_one_by_one() {
        let mut port = UdpPort::open("127.0.0.1:0".parse().unwrap()).unwrap();
        assert!(UdpPort::open(port.address()).is_err(), "one listener at a port");
        assert_eq!(port.next(Duration::ZERO), None);
        let sender = UdpSocket::bind("127.0.0.1:0").unwrap();
        sender.send_to(b"{\"end\":true}\n\n nonsense \n", port.address()).unwrap();
        sender.send_to(b"{\"x\":NaN}", port.address()).unwrap();
        let long = Duration::from_secs(20);
        let got = [port.next(long), port.next(long), port.next(long)];
        assert_eq!(got, [Some(Message::End), Some(Message::Unreadable), Some(Message::NotFinite)]);
    }
}
