"use strict";
// Shows the stream and moves by keys and mouse. The protocol: docs/viewer.md.
const picture = document.getElementById("picture"), state = document.getElementById("state");
const keys = new Set();
let socket, pose, you, pilot, id = 0, moved = false;

function connect() {
  const token = new URLSearchParams(location.search).get("token") ?? undefined;
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/socket`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => send({ type: "hello", protocol: 1, token, ...view() });
  socket.onmessage = ({ data }) => typeof data === "string" ? hear(JSON.parse(data)) : show(data);
  socket.onclose = () => { state.textContent = "The link is lost; connecting again…"; setTimeout(connect, 1000); };
}

const send = message => socket?.readyState === WebSocket.OPEN && socket.send(JSON.stringify(message));
const view = () => ({ size: [innerWidth, innerHeight], dpr: devicePixelRatio });

function hear(message) {
  if (message.type === "welcome") { you = message.you; pose ??= message.world.start; }
  if ("pilot" in message) pilot = message.pilot;
  if ("flight" in message && message.type !== "figures")
    state.textContent = `${message.flight}${message.reason ? ": " + message.reason : ""}, ${pilot === you ? "you fly" : "you watch (Enter: take over)"}`;
  if (message.type === "error" || message.type === "bye") state.textContent = message.text;
}

function show(data) {
  const header = new DataView(data), start = header.getUint16(6, true), kind = header.getUint8(12) ? "image/png" : "image/jpeg";
  if (!moved) pose = Object.fromEntries(["x", "y", "z", "heading", "pitch", "roll", "vfov"].map((name, i) => [name, header.getFloat64(40 + 8 * i, true)]));
  const url = URL.createObjectURL(new Blob([data.slice(start)], { type: kind }));
  picture.onload = () => { URL.revokeObjectURL(url); send({ type: "ack", n: header.getUint32(8, true) }); };
  picture.src = url;
}

let before = performance.now();
function step(now) {
  const seconds = Math.min(0.1, (now - before) / 1000), is = code => Number(keys.has(code));
  before = now;
  moved = keys.size > 0 && pilot === you && !!pose;
  if (moved) {
    const h = pose.heading * Math.PI / 180, fast = keys.has("ShiftLeft") ? 4 : 1, d = 300 * fast * seconds;
    const ahead = (is("KeyW") - is("KeyS")) * d, right = (is("KeyD") - is("KeyA")) * d;
    pose.x += Math.sin(h) * ahead + Math.cos(h) * right;
    pose.y += Math.cos(h) * ahead - Math.sin(h) * right;
    pose.z += (is("KeyE") - is("KeyQ")) * d;
    turn((is("ArrowRight") - is("ArrowLeft")) * 60 * seconds, (is("ArrowUp") - is("ArrowDown")) * 40 * seconds);
  }
  requestAnimationFrame(step);
}

function turn(heading, pitch) {
  pose.heading = (pose.heading + heading + 360) % 360;
  pose.pitch = Math.max(-90, Math.min(90, pose.pitch + pitch));
  send({ type: "pose", id: ++id, ...pose });
}

addEventListener("keydown", event => event.code === "Enter" ? send({ type: "take-over" }) : keys.add(event.code));
addEventListener("keyup", event => keys.delete(event.code));
addEventListener("blur", () => keys.clear());
addEventListener("resize", () => send({ type: "size", ...view() }));
picture.addEventListener("dragstart", event => event.preventDefault());
picture.addEventListener("pointermove", event => {
  if (event.buttons && pose && pilot === you) turn(-event.movementX * 0.1, event.movementY * 0.1);
});
connect();
requestAnimationFrame(step);
