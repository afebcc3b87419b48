// A microphone: a loud sound after a silent time.
#include <ros.h>
#include <std_msgs/Empty.h>

ros::NodeHandle nh;
std_msgs::Empty clap_msg;
ros::Publisher p("clap", &clap_msg);
enum clapper_state { clap1, clap_one_waiting, pause, clap2 };
clapper_state clap;
int volume_thresh = 200;
long int last_time = 0;

void setup() {
  pinMode(13, OUTPUT);
  nh.initNode();
  nh.advertise(p);
}

int event_timer;

void loop() {
  int mic_val = 0;
  for (int i = 0; i < 4; i++) mic_val += analogRead(0);
  mic_val = mic_val / 4 - 512;
  switch (clap) {
    case clap1:
      if (mic_val > volume_thresh) {
        clap = clap_one_waiting;
        last_time = millis();
        digitalWrite(13, HIGH);
        p.publish(&clap_msg);
      }
      break;
    default:
      if (mic_val < volume_thresh && (long)millis() - last_time > event_timer) clap = clap1;
  }
  nh.spinOnce();
}
