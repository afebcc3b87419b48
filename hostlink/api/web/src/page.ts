/** What a panel may use of the page. */

import type { Connection } from "./connection";
import type { Driving } from "./driving";
import type { Fleet } from "./fleet";
import type { Timeline } from "./timeline";
import type { LogLine, RecordingNews } from "./views";

export interface Page {
  /** Robots and links, the newest; the chosen robot; who is silent. */
  readonly fleet: Fleet;
  /** Which part of time is shown, and the instant under the cursor. */
  readonly timeline: Timeline;
  /** The WebSocket: subscribe, publish. */
  readonly connection: Connection;
  /** Hold to drive: for what moves the robot while something is held. */
  readonly driving: Driving;
  /** Whether the daemon allows this page to drive and change; false: the token may only read. */
  readonly canDrive: boolean;
  /** Call whenever the daemon sent something of robots or links, another robot was chosen, or a robot fell silent. */
  onShow(listener: () => void): void;
  /** Call for each log line of a device. */
  onLog(listener: (line: LogLine) => void): void;
  /** Call when a message that this page published was refused. */
  onRefusal(listener: (topic: string, reason: string) => void): void;
  /** Call whenever recordings that are under way, or the number of incidents, have changed. */
  onRecordings(listener: (news: RecordingNews) => void): void;
}
