/** Interface of the page for panels. */

import type { Connection } from "./connection";
import type { Driving } from "./driving";
import type { Fleet } from "./fleet";
import type { Timeline } from "./timeline";
import type { LogLine, RecordingNews } from "./views";

export interface Page {
  /** Robots and links, the chosen robot, and which robots are silent. */
  readonly fleet: Fleet;
  /** The shown part of time, and the cursor's instant. */
  readonly timeline: Timeline;
  /** The WebSocket: subscribe, publish. */
  readonly connection: Connection;
  /** Hold to drive: for controls that move the robot while they are held. */
  readonly driving: Driving;
  /** Whether the daemon allows this page to drive and to change settings; false for the role read. */
  readonly canDrive: boolean;
  /** Call the function when robots or links changed, another robot was chosen, or a robot fell silent. */
  onShow(listener: () => void): void;
  /** Call the function for each log line of a device. */
  onLog(listener: (line: LogLine) => void): void;
  /** Call the function when a message that this page published was refused. */
  onRefusal(listener: (topic: string, reason: string) => void): void;
  /** Call the function when running recordings, or the number of incidents, changed. */
  onRecordings(listener: (news: RecordingNews) => void): void;
}
