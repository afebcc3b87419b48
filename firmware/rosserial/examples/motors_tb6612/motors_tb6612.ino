// cmd_vel to two motors on a TB6612 (AIN1, AIN2, PWMA; STBY on pin 4), with a watchdog: they stop half a second after
// the last command, and at once when the connection to the host is lost.
#include <geometry_msgs/Twist.h>
#include <hostlink/command_watchdog.h>
#include <ros.h>

const float kWheelSeparationM = 0.2f;
const float kTopSpeedMS = 0.5f;

const uint8_t kStandby = 4;

struct Motor {
  uint8_t forwards;
  uint8_t backwards;
  uint8_t pwm;

  void begin() {
    pinMode(forwards, OUTPUT);
    pinMode(backwards, OUTPUT);
    pinMode(pwm, OUTPUT);
    pinMode(kStandby, OUTPUT);
    drive(0);
    digitalWrite(kStandby, HIGH);
  }
  void drive(int duty) {  // both inputs high: the motor is shorted, which brakes it
    digitalWrite(forwards, duty >= 0 ? HIGH : LOW);
    digitalWrite(backwards, duty <= 0 ? HIGH : LOW);
    analogWrite(pwm, duty < 0 ? -duty : duty);
  }
};

Motor left = {7, 8, 5};
Motor right = {9, 10, 6};

ros::NodeHandle nh;
hostlink::CommandWatchdog watchdog([]() {
  left.drive(0);
  right.drive(0);
});

int duty_of(float speed_m_s) {
  const float duty = speed_m_s / kTopSpeedMS * 255.0f;
  if (!(duty > -255.0f)) return duty != duty ? 0 : -255;  // NaN stops the motor
  return duty > 255.0f ? 255 : static_cast<int>(duty);
}

void drive(const geometry_msgs::Twist& command) {
  if (!watchdog.feed()) return;
  const float linear = static_cast<float>(command.linear.x);
  const float difference = static_cast<float>(command.angular.z) * kWheelSeparationM / 2.0f;
  left.drive(duty_of(linear - difference));
  right.drive(duty_of(linear + difference));
}

ros::Subscriber<geometry_msgs::Twist> velocity("cmd_vel", &drive);

void setup() {
  left.begin();
  right.begin();
  nh.initNode();
  nh.attach(watchdog);
  nh.subscribe(velocity);
}

void loop() { nh.spinOnce(); }
