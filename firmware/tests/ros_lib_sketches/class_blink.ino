// A subscriber whose callback is a function of a class.
#include <ros.h>
#include <std_msgs/Bool.h>

ros::NodeHandle nh;

class Blinker {
 public:
  Blinker() : sub_("set_led", &Blinker::set, this) {}
  void init(ros::NodeHandle& node) {
    pinMode(12, OUTPUT);
    node.subscribe(sub_);
  }
  void set(const std_msgs::Bool& message) { digitalWrite(12, message.data ? HIGH : LOW); }

 private:
  ros::Subscriber<std_msgs::Bool, Blinker> sub_;
};

Blinker blinker;

void setup() {
  nh.initNode();
  blinker.init(nh);
}

void loop() {
  nh.spinOnce();
  delay(1);
}
